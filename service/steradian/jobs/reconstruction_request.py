"""Request of a reconstruction: of a volume, a series, a subset, a growing scan, or the unmixing of a series."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from steradian.core.exceptions import InvalidInput
from steradian.core.validation import Value, quantity_field
from steradian.jobs.request_base import Identifier, OfFrames
from steradian.jobs.unmixing_request import UnmixingOptions
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.series.frames import SeriesFrame, series_choices
from steradian.scans.frames import Frame, FrameChoice

_SCAN = "s01jz0000000000000000000000"
RECONSTRUCTION_EXAMPLES: list[Any] = [
    {"scan_id": _SCAN, "parameters": {"modes": 226}},
    {"scan_id": _SCAN, "follow": True, "interval": 2},
    {"scan_id": _SCAN, "through": {"mask_id": "m0123456789abcdef01234567"}},
    {"scan_id": _SCAN, "reconstruction_id": "r01jz0000000000000000000000", "unmixing": {"fluence": {"model": "fit"}}},
]


class Through(Value):
    """Mask for retrospective undersampling: the scan is reconstructed from the points of this mask alone."""

    mask_id: Identifier = Field(description="Identifier of the mask")
    points: Literal["nearest", "exact"] = Field(
        default="nearest", description="nearest: the measured point nearest to each of the mask's; exact: the same ones"
    )


class ReconstructionRequest(OfFrames):
    """Request of a reconstruction: complete, live (following a running scan), with another mask, or an unmixing.

    A scan of several frames becomes a series of volumes, unless ``frame`` chooses one.
    """

    model_config = ConfigDict(json_schema_extra={"examples": RECONSTRUCTION_EXAMPLES})

    scan_id: Identifier = Field(description="Identifier of the scan")
    parameters: ReconstructionParameters = ReconstructionParameters()
    follow: bool = Field(
        default=False,
        description="Start while the scan runs: a revision every few seconds, the complete image at its end",
    )
    interval: float = quantity_field("s", "Between two revisions while following", ge=0.2, le=3600, default=2.0)
    align: bool = Field(default=False, description="Undo shifts of the object between the volumes of a series")
    motion: bool = Field(default=False, description="Estimate and undo motion within each frame; direct methods only")
    through: Through | None = Field(default=None, description="Another mask, of a scan that is over")
    unmixing: UnmixingOptions | None = Field(
        default=None, description="Unmix a series of this scan, reconstruction_id, instead of reconstructing the scan"
    )
    reconstruction_id: Identifier | None = Field(default=None, description="Identifier of the series that is unmixed")

    @model_validator(mode="after")
    def _check(self) -> Self:
        self._check_unmixing()
        told = {"frame": self.frame, "wavelength": self.wavelength, "average": self.average or None}
        given = [name for name, value in told.items() if value is not None]
        if self.through is not None and (self.follow or given):
            raise InvalidInput("through", self.through.mask_id, "neither follow nor frame, wavelength, average with it")
        if self.follow and given:
            raise InvalidInput(given[0], told[given[0]], "none while following")
        if self.follow and (treatment := self.parameters.shots.bad_lines) != "keep":
            raise InvalidInput("parameters.shots.bad_lines", treatment, "keep while following")
        if self.follow and self.parameters.lossy:
            raise InvalidInput("parameters.medium", "with attenuation", "one without attenuation while following")
        for name in ("align", "motion"):
            if getattr(self, name) and self.kind in ("live", "what-if"):
                raise InvalidInput(name, "true", f"false of a reconstruction that is {self.kind}")
        if self.align and self.frame is not None:
            raise InvalidInput("align", "true", "a series: no frame chosen")
        FrameChoice(self.frame, self.wavelength, self.average)
        return self

    def _check_unmixing(self) -> None:
        if (self.unmixing is None) != (self.reconstruction_id is None):
            value = self.reconstruction_id or "missing"
            raise InvalidInput("reconstruction_id", value, "the series that is unmixed, with unmixing")
        if self.unmixing is None:
            return
        for name in ("follow", "through", "frame", "wavelength", "average", "align", "motion", "parameters"):
            if (value := getattr(self, name)) != type(self).model_fields[name].default:
                raise InvalidInput(name, str(value), "nothing beside unmixing, whose series has been reconstructed")

    @property
    def kind(self) -> Literal["reconstruction", "live", "what-if", "unmixing"]:
        """Job kind that follows from the request."""
        if self.unmixing is not None:
            return "unmixing"
        return "live" if self.follow else "reconstruction" if self.through is None else "what-if"

    def series(self, frames: Sequence[Frame]) -> list[tuple[SeriesFrame, int | FrameChoice]]:
        """Return the frames of the series that the request makes of a scan's; one or none for a single volume.

        Raises
        ------
        InvalidInput
            When the scan has no such frame or wavelength.
        """
        if self.kind == "reconstruction" and self.frame is None:
            return series_choices(frames, wavelength=self.wavelength, average=self.average)
        self.frames.pick(frames)
        return []
