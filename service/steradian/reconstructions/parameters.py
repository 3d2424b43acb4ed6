"""Reconstruction parameters of the service and command line."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import LENGTH, MODES, PADDING, SOUND_SPEED, TOLERANCE, UPSAMPLING
from steradian.core.schema_descriptions import SchemaDescriptions
from steradian.core.validation import Value, quantity_field
from steradian.imaging.iterative_options import IterativeOptions
from steradian.imaging.medium import MAX_LAYERS
from steradian.imaging.signal.conditioning import Conditioning, Display
from steradian.reconstructions.film_response_choice import Film
from steradian.reconstructions.medium_parameters import LayerParameters, check_layers
from steradian.reconstructions.shot_normalisation import ShotTreatment

LARGE = 1_000_000_000
"""Bytes of a volume file above which it is not made unasked."""
DEFAULT_SPACING = 60e-6
"""Lateral spacing in metres where neither the caller nor an imported lattice says otherwise (the paper's yarn)."""

Method = Literal["nedner", "ner", "linear", "nearest", "interpolated", "iterative"]
Weights = Literal["mask", "uniform", "voronoi"]
LAYERED_METHODS = ("nedner", "ner", "iterative")
"""Methods that image a medium of several layers."""


def default_modes(lattice: int | None, aperture: float) -> int:
    """Return the default number of lateral modes per axis: from the sensor pitch if unusual, else for 60 µm voxels.

    ``lattice`` is :attr:`Recording.grid`, ``aperture`` in m.
    """
    return min(lattice or max(2, round(aperture / DEFAULT_SPACING)), int(MODES.high))


class ReconstructionParameters(Value):
    """Parameters of a reconstruction; ``None`` means the value recorded in the scan."""

    method: Method = Field(default="nedner", description="nedner uses NER by itself where the sensors allow it")
    modes: int | None = quantity_field(
        "modes",
        "Lateral modes per axis; none: voxels of 60 µm, or of an imported pitch below that or above 0.5 mm",
        **MODES.limits,
        default=None,
    )
    upsampling: int = quantity_field(
        "times", "Sinc interpolation of the finished image", **UPSAMPLING.limits, default=1
    )
    depth_range: tuple[float | None, float | None] | None = Field(
        default=None,
        description="First and last depth wanted, in metres; none: from 0, or where the record begins if that is later "
        "after the pulse than a quarter of its length, to the end of the record",
        json_schema_extra={"unit": "m"},
    )
    weights: Weights = Field(
        default="mask",
        description="Areas h of the sensors, whose sum is the sensed area: the mask's own, equal, or Voronoi cells",
    )
    sound_speed: float | None = quantity_field(
        "m/s", "Speed of sound; none: the scan's, or those of the medium", default=None, **SOUND_SPEED.limits
    )
    medium: tuple[LayerParameters, ...] | None = Field(
        default=None,
        min_length=1,
        max_length=MAX_LAYERS,
        description="Layers from the film downwards, in place of sound_speed: speeds, thicknesses, attenuation; none: "
        "one lossless layer",
    )
    tolerance: float = quantity_field("relative", "l2 error of the transforms", **TOLERANCE.limits, default=1e-4)
    window: Literal["kaiser-bessel", "semicircle"] = Field(
        default="kaiser-bessel", description="Shape of the interpolation window"
    )
    time_padding: float = quantity_field(
        "times", "Zeros after the record against wrap-around", **PADDING.limits, default=1.0
    )
    lateral_padding: float | None = quantity_field(
        "times",
        "Zeros around the aperture against sources outside it; none: 1, and as much as it needs for iterative",
        **PADDING.limits,
        default=None,
    )
    highest_frequency: float | Literal["signal"] | None = Field(
        default=None,
        description="Leave out what is above (Hz): fewer slices, at about that share of the cost; signal: where the "
        "A-lines' signal ends in noise; none: all",
        json_schema_extra={"unit": "Hz"},
    )
    depth_step: float | None = quantity_field(
        "m",
        "Distance of slices, at most; none: that of samples, with a highest frequency as far apart as it allows",
        **LENGTH.limits,
        default=None,
    )
    device: Literal["auto", "cpu", "gpu"] = Field(
        default="auto",
        description="auto: the worker's GPU, if it has one with memory enough; the result is the same",
    )
    iterative: Annotated[IterativeOptions, SchemaDescriptions(IterativeOptions, highest_frequency="Hz")] = Field(
        default=IterativeOptions(), description="Regulariser and stopping rule of the method iterative"
    )
    film: Film = Field(default=Film(), description="Response of the sensor, corrected for")
    shots: ShotTreatment = Field(default=ShotTreatment(), description="Shot normalisation")
    conditioning: Annotated[
        Conditioning, SchemaDescriptions(Conditioning, zero_first="samples", rim="m", band="Hz", delay="s")
    ] = Field(default=Conditioning(), description="Preprocessing")
    display: Annotated[
        Display,
        SchemaDescriptions(
            Display, gain_db_per_mm="dB/mm", log_range_db="dB", near_field="m", scale_bar="m", size="pixels"
        ),
    ] = Field(default=Display(), description="Image display")

    @model_validator(mode="after")
    def _check(self) -> Self:
        highest = self.highest_frequency
        if highest is not None and highest != "signal" and highest <= 0:
            raise InvalidInput("highest_frequency", highest, 'a frequency above 0 Hz, "signal" or none')
        if self.method == "iterative" and highest is not None:
            raise InvalidInput("highest_frequency", highest, "none with the method iterative; iterative has one")
        if self.method == "iterative" and self.depth_step is not None:
            raise InvalidInput("depth_step", self.depth_step, "none with the method iterative")
        if self.method != "iterative" and self.iterative != IterativeOptions():
            raise InvalidInput("iterative", "given", f"nothing with the method {self.method}: of iterative alone")
        self._check_medium()
        if self.depth_range is not None:
            first, last = self.depth_range
            if (first or 0.0) < 0 or (last is not None and last <= (first or 0.0)):
                raise InvalidInput("depth_range", self.depth_range, "0 ≤ first < last (m)")
        return self

    def _check_medium(self) -> None:
        if self.medium is None:
            return
        if self.sound_speed is not None:
            raise InvalidInput("sound_speed", self.sound_speed, "none beside a medium, whose layers have their own")
        check_layers(self.medium)
        if len(self.medium) == 1:
            return
        if self.method not in LAYERED_METHODS:
            raise InvalidInput("method", self.method, f"{', '.join(LAYERED_METHODS)} for a medium of several layers")
        if self.method == "iterative" and self.device == "gpu":
            allowed = "auto or cpu with the method iterative and a medium of several layers"
            raise InvalidInput("device", self.device, allowed)

    @property
    def lossy(self) -> bool:
        """Whether a layer of the medium attenuates."""
        return any(one.attenuation is not None and one.attenuation.coefficient > 0 for one in self.medium or ())
