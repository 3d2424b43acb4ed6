"""A mask: where on the sensor plane to sense, and which share of the plane each point stands for."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from steradian.errors import InvalidInput
from steradian.ranges import LENGTH
from steradian.validation import FloatArray, Value, content_hash, quantity

AREA_TOLERANCE = 1e-9
"""Relative deviation of Σ weights from the aperture's area that is still rounding."""


class Mask(Value):
    """Sensor positions with weights; immutable and identified by its content.

    The plane is z = 0 and the aperture the square [−X/2, X/2]² around the origin; the object lies at z > 0. A line of
    sensors for 2-D images has positions (M, 1) along x and the aperture [−X/2, X/2].
    """

    aperture: float = quantity(
        "m", "Side X of the square aperture, the lateral period of a reconstruction", **LENGTH.limits
    )
    positions: FloatArray = Field(
        description="(M, 2) sensor positions x, y in metres, centred on the aperture; (M, 1) for a line"
    )
    weights: FloatArray = Field(description="(M,) areas h in m², sum X² (lengths in m, sum X, for a line)")
    depth: float | None = quantity(
        "m", "Distance r0 of the point of interest from the plane", default=None, **LENGTH.limits
    )
    offset: tuple[float, float] = Field(
        default=(0.0, 0.0), description="x and y of the point of interest, centred on the aperture (m)"
    )
    arrangement: dict[str, Any] = Field(description="Kind of arrangement and the parameters that made it")

    @model_validator(mode="after")
    def _check(self) -> Self:
        shape = self.positions.shape
        if len(shape) != 2 or shape[1] not in (1, 2) or not shape[0]:
            raise InvalidInput("positions", f"an array of shape {shape}", "(M, 2), or (M, 1) for a line; M at least 1")
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
        if abs(self.weights.sum() / self.area - 1) > AREA_TOLERANCE:
            raise InvalidInput("weights", f"a sum of {self.weights.sum():g}", f"the aperture's area, {self.area:g} m²")
        return self

    @cached_property
    def id(self) -> str:
        """Identifier of the content, ``m`` and 24 hexadecimal digits."""
        parameters = {
            "aperture": self.aperture,
            "depth": self.depth,
            "offset": self.offset,
            "arrangement": self.arrangement,
        }
        return content_hash("m", parameters, self.positions, self.weights)

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

    @property
    def weight_ratio(self) -> float:
        """Largest over smallest weight (9.7 for the paper's yarn mask)."""
        return float(self.weights.max() / self.weights.min())

    @cached_property
    def film_positions(self) -> NDArray[np.float64]:
        """(M, 2) positions x, y in metres for a scanner; a line lies at y = 0."""
        if not self.is_line:
            return self.positions
        found = np.column_stack([self.positions[:, 0], np.zeros(self.count)])
        found.setflags(write=False)
        return found

    @property
    def points_of_interest(self) -> NDArray[np.float64]:
        """(P, 3) points of interest x, y, z in metres; P is 0 for an arrangement without one."""
        several = self.arrangement.get("points_of_interest")
        if several:
            return np.array([[*point["offset"], point["depth"]] for point in several], dtype=np.float64)
        return np.empty((0, 3)) if self.depth is None else np.array([[*self.offset, self.depth]])
