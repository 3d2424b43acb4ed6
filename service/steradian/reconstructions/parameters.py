"""What may be chosen about a reconstruction."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from steradian.errors import InvalidInput
from steradian.imaging.conditioning import Conditioning, Display
from steradian.imaging.iterative_options import Iterative
from steradian.ranges import SOUND_SPEED
from steradian.reconstructions.film import Film
from steradian.reconstructions.shots import ShotTreatment
from steradian.validation import Value, quantity

DEFAULT_SPACING = 60e-6
"""Lateral spacing in metres where neither the caller nor a grid of sensors says otherwise (the paper's yarn)."""

Method = Literal["nedner", "ner", "linear", "nearest", "interpolated", "iterative"]
Weights = Literal["mask", "uniform", "voronoi"]


class ReconstructionParameters(Value):
    """Parameters of one reconstruction; ``None`` means "as the scan says"."""

    method: Method = Field(default="nedner", description="nedner uses NER by itself where the sensors allow it")
    modes: int | None = quantity(
        "modes", "Lateral modes per axis; none: a grid's sensors, else aperture / 60 µm", ge=2, le=4096, default=None
    )
    upsampling: int = quantity("times", "Sinc interpolation of the finished image", ge=1, le=8, default=1)
    depth_range: tuple[float | None, float | None] | None = Field(
        default=None, description="First and last depth wanted, in metres; none: from 0, to the end of the record"
    )
    weights: Weights = Field(
        default="mask",
        description="Areas h of the sensors, whose sum is the sensed area: the mask's own, equal, or Voronoi cells",
    )
    sound_speed: float | None = quantity("m/s", "Speed of sound; none: the scan's", default=None, **SOUND_SPEED.limits)
    tolerance: float = quantity("relative", "Wanted l2 error of the transforms", ge=1e-9, le=1e-2, default=1e-4)
    window: Literal["kaiser-bessel", "semicircle"] = Field(
        default="kaiser-bessel", description="Shape of the interpolation window"
    )
    time_padding: float = quantity("times", "Zeros after the record against wrap-around", ge=1, le=16, default=1.0)
    lateral_padding: float = quantity(
        "times", "Zeros around the aperture against sources outside it", ge=1, le=16, default=1.0
    )
    iterative: Iterative = Field(
        default=Iterative(), description="Regulariser and stopping rule of the method iterative"
    )
    film: Film = Field(default=Film(), description="Response of the sensor, corrected for")
    shots: ShotTreatment = Field(
        default=ShotTreatment(), description="What is done about differences from A-line to A-line"
    )
    conditioning: Conditioning = Field(default=Conditioning(), description="What is done to the A-lines before")
    display: Display = Field(default=Display(), description="What is done to the image before it is drawn")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.depth_range is not None:
            first, last = self.depth_range
            if (first or 0.0) < 0 or (last is not None and last <= (first or 0.0)):
                raise InvalidInput("depth_range", self.depth_range, "0 ≤ first < last (m)")
        return self
