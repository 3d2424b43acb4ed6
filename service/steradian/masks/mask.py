"""Mask: sensor positions on the sensor plane, with the area that each represents."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, computed_field, model_validator

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import LENGTH
from steradian.core.validation import FloatArray, content_hash, quantity_field
from steradian.drawing.displayable import DisplayableValue
from steradian.imaging.geometry import polygons as outlines
from steradian.imaging.validation import MAX_AREA_RATIO

AREA_TOLERANCE = 1e-9
"""Relative deviation of Σ weights from the outline's area that is still rounding."""


class Mask(DisplayableValue):
    """Sensor positions with weights; immutable and identified by its content.

    The plane is z = 0 and the aperture the square [−X/2, X/2]² around the origin; the object lies at z > 0. A line of
    sensors for 2-D images has positions (M, 1) along x and the aperture [−X/2, X/2].

    Weights are areas: each point stands for its cell within what the mask senses, the ``outline``, which need not be
    the aperture (an equi-steradian mask senses a disc). A mask whose outline is not known, such as one made before
    outlines were kept, senses what its weights sum to; then that was the aperture's area whatever the points cover.
    """

    aperture: float = quantity_field(
        "m", "Side X of the square aperture, the lateral period of a reconstruction", **LENGTH.limits
    )
    positions: FloatArray = Field(
        description="(M, 2) sensor positions x, y in metres, centred on the aperture; (M, 1) for a line"
    )
    weights: FloatArray = Field(description="(M,) areas h in m², lengths in m for a line; their sum is the sensed area")
    outline: FloatArray | None = Field(
        default=None,
        description="(V, 2) corners of the convex polygon that is sensed, anticlockwise, in metres; (2, 1) for a line; "
        "null: not known",
    )
    depth: float | None = quantity_field(
        "m", "Distance r0 of the point of interest from the plane", default=None, **LENGTH.limits
    )
    offset: tuple[float, float] = Field(
        default=(0.0, 0.0), description="x and y of the point of interest, centred on the aperture (m)"
    )
    arrangement: dict[str, Any] = Field(description="Kind of arrangement and the parameters that made it")

    @model_validator(mode="before")
    @classmethod
    def _drop_derived_fields(cls, fields: Any) -> Any:
        """Remove the derived sensed area from a mask's JSON."""
        if isinstance(fields, dict) and "sensed_area" in fields:
            return {name: value for name, value in fields.items() if name != "sensed_area"}
        return fields

    @model_validator(mode="after")
    def _check(self) -> Self:
        check_shape(self.positions)
        if self.weights.shape != (len(self.positions),):
            raise InvalidInput("weights", f"an array of shape {self.weights.shape}", f"({len(self.positions)},)")
        if (self.weights <= 0).any():
            raise InvalidInput("weights", f"{self.weights.min():g} at {int(self.weights.argmin())}", "> 0 (m²)")
        reach = np.abs(self.positions).max(axis=1)
        worst = int(reach.argmax())
        half = self.aperture / 2
        if reach[worst] > half * (1 + 1e-12):
            point = ", ".join(f"{1e3 * c:.4g}" for c in self.positions[worst])
            raise InvalidInput(
                f"positions[{worst}]", f"({point}) mm", f"within the aperture, ±{1e3 * half:.4g} mm on each axis"
            )
        self._check_area()
        return self

    def _check_area(self) -> None:
        if self.sensed_area > MAX_AREA_RATIO * self.area:
            raise InvalidInput(
                "weights",
                f"a sum of {self.sensed_area:g}",
                f"areas, at most {MAX_AREA_RATIO:g} apertures of {self.area:g} m²",
            )
        if self.outline is None:
            return
        if self.outline.ndim != 2 or self.outline.shape[1] != self.positions.shape[1]:
            raise InvalidInput("outline", f"an array of shape {self.outline.shape}", "(V, 2), or (2, 1) for a line")
        if not outlines.is_convex(self.outline):
            raise InvalidInput("outline", "a polygon", "convex, its corners anticlockwise; low and high end on a line")
        covered = outlines.area(self.outline)
        if not abs(self.sensed_area / covered - 1) <= AREA_TOLERANCE:
            raise InvalidInput("weights", f"a sum of {self.sensed_area:g}", f"the outline's area, {covered:g} m²")

    @cached_property
    def id(self) -> str:
        """Identifier of the content, ``m`` and 24 hexadecimal digits."""
        parameters = {
            "aperture": self.aperture,
            "depth": self.depth,
            "offset": self.offset,
            "arrangement": self.arrangement,
        }
        arrays = () if self.outline is None else (self.outline,)
        return content_hash("m", parameters, self.positions, self.weights, *arrays)

    @property
    def count(self) -> int:
        """Number of sensor positions M."""
        return len(self.positions)

    @property
    def is_line(self) -> bool:
        """Whether the sensors lie on a line, for 2-D images."""
        return bool(self.positions.shape[1] == 1)

    @property
    def area(self) -> float:
        """Area X² of the aperture in m²; for a line its length X in m."""
        return float(self.aperture ** self.positions.shape[1])

    @computed_field  # type: ignore[prop-decorator]
    @property
    def sensed_area(self) -> float:
        """Area in m² represented by all points, the sum of their weights; for a line a length in m."""
        return float(self.weights.sum())

    @property
    def weight_ratio(self) -> float:
        """Ratio of the largest to the smallest weight.

        Of the paper's yarn mask 9.4 with the paper's weights, which states 9.7, and 8.2 with the default ones, which
        give the last slice only what lies within the disc.

        Examples
        --------
        >>> from steradian import equi_steradian_mask
        >>> round(equi_steradian_mask(13.56e-3, 3.6e-3, 1600).weight_ratio, 1)
        8.2
        >>> round(equi_steradian_mask(13.56e-3, 3.6e-3, 1600, weighting="analytic").weight_ratio, 1)
        9.4
        """
        return float(self.weights.max() / self.weights.min())

    @cached_property
    def film_positions(self) -> NDArray[np.float64]:
        """Positions x, y (M, 2) in metres for a scanner; a line lies at y = 0."""
        if not self.is_line:
            return self.positions
        found = np.column_stack([self.positions[:, 0], np.zeros(self.count)])
        found.setflags(write=False)
        return found

    @property
    def points_of_interest(self) -> NDArray[np.float64]:
        """Points of interest x, y, z (P, 3) in metres; P is 0 for an arrangement without one."""
        several = self.arrangement.get("points_of_interest")
        if several:
            return np.array([[*point["offset"], point["depth"]] for point in several], dtype=np.float64)
        return np.empty((0, 3)) if self.depth is None else np.array([[*self.offset, self.depth]])

    @property
    def title(self) -> str:
        """Summary line: arrangement, number of points, aperture and point of interest."""
        name = str(self.arrangement.get("arrangement", "mask")).capitalize()
        parts = [f"{name} mask, {self.count:,} points over {1e3 * self.aperture:.4g} mm"]
        points = self.points_of_interest
        if len(points) == 1:
            parts.append(f"point of interest {1e3 * points[0, 2]:.4g} mm deep")
        elif len(points):
            parts.append(f"{len(points)} points of interest")
        return ", ".join(parts)

    def __repr__(self) -> str:
        name, _, rest = self.title.partition(" mask, ")
        return f"<Mask: {name.lower()}, {rest}>"


def check_shape(positions: NDArray[np.float64]) -> None:
    """Validate the shape of positions of a plane or line; raises :class:`InvalidInput`."""
    shape = positions.shape
    if len(shape) != 2 or shape[1] not in (1, 2) or not shape[0]:
        raise InvalidInput("positions", f"an array of shape {shape}", "(M, 2), or (M, 1) for a line; M at least 1")
