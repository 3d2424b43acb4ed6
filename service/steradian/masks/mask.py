"""A mask: where on the sensor plane to sense, and which share of the plane each point stands for."""

from __future__ import annotations

from functools import cached_property
from typing import Any, Self

import numpy as np
from pydantic import Field, model_validator

from steradian.errors import InvalidInput
from steradian.validation import FloatArray, Value, content_hash, quantity

AREA_TOLERANCE = 1e-9
"""Relative deviation of Σ weights from the aperture's area that is still rounding."""


class Mask(Value):
    """Sensor positions with weights; immutable and identified by its content.

    The plane is z = 0 and the aperture the square [−X/2, X/2]² around the origin; the object lies at z > 0.
    """

    aperture: float = quantity("m", "Side X of the square aperture, the lateral period of a reconstruction", gt=0, le=1)
    positions: FloatArray = Field(description="(M, 2) sensor positions x, y in metres, centred on the aperture")
    weights: FloatArray = Field(description="(M,) areas h in m²; their sum is X² (paper, section 2)")
    depth: float | None = Field(default=None, description="Distance r0 of the point of interest from the plane (m)")
    arrangement: dict[str, Any] = Field(description="Kind of arrangement and the parameters that made it")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.positions.ndim != 2 or self.positions.shape[1] != 2 or not len(self.positions):
            raise InvalidInput("positions", f"an array of shape {self.positions.shape}", "(M, 2) with M at least 1")
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
        parameters = {"aperture": self.aperture, "depth": self.depth, "arrangement": self.arrangement}
        return content_hash("m", parameters, self.positions, self.weights)

    @property
    def count(self) -> int:
        """Number of sensor positions M."""
        return len(self.positions)

    @property
    def area(self) -> float:
        """Area of the aperture in m²."""
        return self.aperture**2

    @property
    def weight_ratio(self) -> float:
        """Largest over smallest weight (9.7 for the paper's yarn mask)."""
        return float(self.weights.max() / self.weights.min())
