"""What may be chosen about a reconstruction."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from steradian.errors import InvalidInput
from steradian.validation import Value, quantity

DEFAULT_SPACING = 60e-6
"""Lateral spacing in metres where neither the caller nor a grid of sensors says otherwise (the paper's yarn)."""


class ReconstructionParameters(Value):
    """Parameters of one reconstruction; ``None`` means "as the scan says"."""

    method: Literal["nedner", "ner", "linear", "interpolated"] = Field(
        default="nedner", description="nedner uses NER by itself where the sensors allow it"
    )
    modes: int | None = quantity(
        "modes", "Lateral modes per axis; none: a grid's sensors, else aperture / 60 µm", ge=2, le=4096, default=None
    )
    upsampling: int = quantity("times", "Sinc interpolation of the finished image", ge=1, le=8, default=1)
    depth_range: tuple[float, float] | None = Field(default=None, description="First and last depth wanted, in metres")
    weights: Literal["mask", "uniform", "voronoi"] = Field(
        default="mask", description="Areas h of the sensors: the mask's own, equal, or Voronoi cells"
    )
    sound_speed: float | None = quantity("m/s", "Speed of sound; none: the scan's", ge=300, le=6000, default=None)
    tolerance: float = quantity(
        "relative", "Wanted relative l2 error of the transforms", ge=1e-9, le=1e-2, default=1e-4
    )

    @model_validator(mode="after")
    def _check(self) -> ReconstructionParameters:
        if self.depth_range is not None and not 0 <= self.depth_range[0] < self.depth_range[1]:
            raise InvalidInput("depth_range", self.depth_range, "0 ≤ first < last (m)")
        return self
