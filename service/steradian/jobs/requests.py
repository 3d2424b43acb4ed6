"""What each kind of job is asked to do: checked when it is queued, and again when it starts.

Jobs name resources by identifier; where their files lie follows from the data directory of whoever runs them.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self, TypeAlias

from pydantic import ConfigDict, Field, StringConstraints, model_validator

from steradian.errors import InvalidInput
from steradian.ranges import LENGTH, SOUND_SPEED
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.validation import Value, quantity

Identifier: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9]+$")]
"""A resource's identifier; it becomes part of a path."""
Name: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=60)]
Text: TypeAlias = Annotated[str, StringConstraints(max_length=200)]
Format: TypeAlias = Literal["hdf5", "nifti", "tiff", "ome-zarr", "vtkhdf", "nrrd", "png", "ipasc"]
SUFFIXES: dict[str, str] = {
    "hdf5": ".h5",
    "nifti": ".nii.gz",
    "tiff": ".tif",
    "ome-zarr": ".ome.zarr",
    "vtkhdf": ".vtkhdf",
    "nrrd": ".nrrd",
    "png": ".projections",
    "ipasc": ".hdf5",
}
EXAMPLES: dict[str, Any] = {
    "sound-speed": {"kind": "sound-speed", "scan_id": "s01jz0000000000000000000000", "first": 1450, "last": 1550},
    "quality": {
        "kind": "quality",
        "reconstruction_id": "r01jz0000000000000000000000",
        "reference_id": "r01jz0000000000000000000001",
    },
    "export": {"kind": "export", "reconstruction_id": "r01jz0000000000000000000000", "format": "nifti"},
    "import": {"kind": "import", "upload_id": "u01jz0000000000000000000000", "labels": {"from": "k-Wave"}},
}
"""A request of each kind of job."""


class Reconstruction(Value):
    """A scan's A-lines into a volume."""

    scan: str = Field(description="The recording's path, relative to the data directory where it lies there")
    output: str = Field(description="Folder for the results, likewise")
    parameters: ReconstructionParameters = ReconstructionParameters()
    frame: int | None = Field(default=None, ge=0, description="Which frame of the scan; none: the first")


class Live(Value):
    """The same while the scan still runs, again and again."""

    scan_id: Identifier
    parameters: ReconstructionParameters = ReconstructionParameters()
    interval: float = quantity("s", "Between the beginnings of two revisions", ge=0.2, le=3600, default=2.0)


class WhatIf(Value):
    """A finished scan as if another mask had been measured."""

    scan_id: Identifier
    mask_id: Identifier
    points: Literal["nearest", "exact"] = Field(
        default="nearest", description="nearest: the measured point nearest to each of the mask's; exact: the same"
    )
    parameters: ReconstructionParameters = ReconstructionParameters()


class SoundSpeed(Value):
    """How sharp the image is at each speed of sound."""

    model_config = ConfigDict(json_schema_extra={"examples": [EXAMPLES["sound-speed"]]})

    kind: Literal["sound-speed"] = "sound-speed"
    scan_id: Identifier = Field(description="Identifier of the scan")
    first: float = quantity("m/s", "Lowest speed tried", **SOUND_SPEED.limits)
    last: float = quantity("m/s", "Highest speed tried", **SOUND_SPEED.limits)
    steps: int = quantity("speeds", "How many are tried, evenly spaced", ge=3, le=200, default=21)
    parameters: ReconstructionParameters = ReconstructionParameters()

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.last <= self.first:
            raise InvalidInput("last", self.last, f"> first, {self.first:g} (m/s)")
        return self


class Quality(Value):
    """How much an image is like another one."""

    model_config = ConfigDict(json_schema_extra={"examples": [EXAMPLES["quality"]]})

    kind: Literal["quality"] = "quality"
    reconstruction_id: Identifier = Field(description="Identifier of the reconstruction that is judged")
    reference_id: Identifier = Field(description="Identifier of the one it is compared with, of the same voxels")
    diameter: float | None = quantity(
        "m", "Of the disc around the axis that counts; none: everything", default=None, **LENGTH.limits
    )
    threshold: float = quantity(
        "share", "Of the reference's maximum, from which a voxel is of interest", ge=0, lt=1, default=0.04
    )


class Export(Value):
    """A volume or scan in a format of other programs."""

    model_config = ConfigDict(json_schema_extra={"examples": [EXAMPLES["export"]]})

    kind: Literal["export"] = "export"
    reconstruction_id: Identifier | None = Field(default=None, description="Identifier of the reconstruction")
    scan_id: Identifier | None = Field(default=None, description="Identifier of the scan, instead")
    format: Format = Field(description="ipasc is for scans, all others are for reconstructions")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.reconstruction_id is None) == (self.scan_id is None):
            raise InvalidInput("reconstruction_id", self.reconstruction_id, "this one or scan_id, not both")
        if (self.format == "ipasc") != (self.scan_id is not None):
            allowed = "ipasc" if self.scan_id else ", ".join(name for name in SUFFIXES if name != "ipasc")
            raise InvalidInput("format", self.format, allowed)
        return self


class Import(Value):
    """A recording from elsewhere becomes a scan."""

    model_config = ConfigDict(json_schema_extra={"examples": [EXAMPLES["import"]]})

    kind: Literal["import"] = "import"
    upload_id: Identifier = Field(description="Identifier of the upload")
    description: dict[str, Any] | None = Field(
        default=None, description="What the file itself does not say: sampling_interval, positions, sound_speed, …"
    )
    companion_id: Identifier | None = Field(
        default=None, description="Identifier of an upload with the positions (csv, npy) or of k-Wave's input file"
    )
    labels: dict[Name, Text] = Field(default_factory=dict, max_length=50, description="Labels of the scan")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if isinstance((self.description or {}).get("positions"), str):  # a path of whoever runs the service
            raise InvalidInput("description.positions", "a name", "numbers, or a file sent as companion_id")
        return self


class ImportAs(Import):
    """The same with the identifier that the scan will have, chosen when the job was queued."""

    scan_id: Identifier
    principal: str


Asked: TypeAlias = SoundSpeed | Quality | Export | Import
"""What may be asked for as a job of its own; reconstructions have resources of their own."""
