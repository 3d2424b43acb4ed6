"""Base class of arrangements with an optional point of interest."""

from __future__ import annotations

from typing import Any, Self

from pydantic import Field, model_validator

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import LENGTH
from steradian.core.validation import Value, quantity_field

MAX_POINTS = 1_000_000
COUNT_FIELD = {"ge": 1, "le": MAX_POINTS}
"""Limits of a number of points."""
POINT_OF_INTEREST_FIELDS = {"depth", "offset"}
"""Fields that a mask keeps itself, beside its arrangement's parameters."""


class ArrangementBase(Value):
    """Base class of mask arrangements with points that do not depend on the point of interest."""

    aperture: float = quantity_field("m", "Side X of the square aperture", **LENGTH.limits)
    depth: float | None = quantity_field(
        "m", "Distance of the point of interest from the plane", default=None, **LENGTH.limits
    )
    offset: tuple[float, float] = Field(
        default=(0.0, 0.0), description="x and y of the point of interest, centred on the aperture (m)"
    )

    @model_validator(mode="after")
    def _check_aim(self) -> Self:
        if self.depth is None and self.offset != (0.0, 0.0):
            raise InvalidInput("offset", self.offset, "only with the depth of the point of interest")
        check_offset(self.offset, self.aperture)
        return self

    def _fields_of_mask(self) -> dict[str, Any]:
        """Return the fields point of interest and parameters of the arrangement's mask."""
        arrangement = self.model_dump(mode="json", exclude=POINT_OF_INTEREST_FIELDS, exclude_none=True)
        return {"depth": self.depth, "offset": self.offset, "arrangement": arrangement}


def check_offset(offset: tuple[float, float], aperture: float) -> None:
    """Raise ``InvalidInput`` for a point of interest that is not over the aperture."""
    if max(abs(offset[0]), abs(offset[1])) > aperture / 2:
        raise InvalidInput("offset", offset, f"over the aperture, ±{aperture / 2:g} (m) on each axis")


def require_exactly_one(**given: object) -> None:
    """Raise ``InvalidInput`` unless exactly one of two fields is given."""
    (first, one), (second, other) = given.items()
    if (one is None) == (other is None):
        raise InvalidInput(first, f"both or neither of {first} and {second}", "one of them")


def count_along_side(aperture: float, spacing: float) -> float:
    """Return how often a spacing fits into the aperture's side, limited to the maximum number of points."""
    return min(aperture / spacing, float(MAX_POINTS))


def closeness_key(found: int, wanted: int) -> tuple[int, int]:
    """Return a sort key of point counts: nearest to the target first, the larger of two equally near."""
    return abs(found - wanted), -found
