"""Request models of all job kinds; used as HTTP body, stored payload and handler argument.

One model all the way. Jobs name resources by identifier; where their files lie follows from the data directory of
whoever runs them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Self, TypeAlias

from pydantic import ConfigDict, Field, StringConstraints, model_validator

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import LENGTH, SOUND_SPEED
from steradian.core.validation import Value, quantity_field
from steradian.jobs.job import DEFAULT_PRIORITY, LOWEST_PRIORITY, JobRequest, Requirements
from steradian.jobs.request_versions import stored
from steradian.reconstructions.exporting import FORMATS as VOLUME_FORMATS
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.scans.exporting import FORMATS as SCAN_FORMATS
from steradian.scans.frames import FrameChoice

Identifier: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9]+$")]
"""A resource's identifier; it becomes part of a path."""
Name: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=60)]
Text: TypeAlias = Annotated[str, StringConstraints(max_length=200)]
SUFFIXES: Final[dict[str, str]] = {name: entry.suffix for name, entry in VOLUME_FORMATS.items()} | {
    name: endings[0] for name, endings in SCAN_FORMATS.items()
}
"""Endings of exported files by format, of volumes and scans."""
if TYPE_CHECKING:
    Format: TypeAlias = str
else:
    Format = Literal[tuple(SUFFIXES)]
EXAMPLES: dict[str, Any] = {
    "sound-speed": {"kind": "sound-speed", "scan_id": "s01jz0000000000000000000000", "first": 1450, "last": 1550},
    "quality": {
        "kind": "quality",
        "reconstruction_id": "r01jz0000000000000000000000",
        "reference_id": "r01jz0000000000000000000001",
    },
    "width": {
        "kind": "width",
        "scan_id": "s01jz0000000000000000000000",
        "reconstruction_id": "r01jz0000000000000000000000",
        "start": [-1e-3, 0, 2.5e-3],
        "end": [1e-3, 0, 2.5e-3],
    },
    "export": {"kind": "export", "reconstruction_id": "r01jz0000000000000000000000", "format": "nifti"},
    "import": {"kind": "import", "upload_id": "u01jz0000000000000000000000", "labels": {"from": "k-Wave"}},
}
"""A request of each kind of job."""
_SCAN = "s01jz0000000000000000000000"
RECONSTRUCTION_EXAMPLES: list[Any] = [
    {"scan_id": _SCAN, "parameters": {"modes": 226}},
    {"scan_id": _SCAN, "follow": True, "interval": 2},
    {"scan_id": _SCAN, "through": {"mask_id": "m0123456789abcdef01234567"}},
]


class Required(Value):
    """Explicit requirements on a job's worker (memory, cores), in addition to those that follow from the job.

    Memory for its volume, and a GPU.
    """

    memory: int | None = Field(default=None, ge=1, le=2**50, description="Memory of the worker, at least (bytes)")
    cores: int | None = Field(default=None, ge=1, le=4096, description="Threads that its jobs may use, at least")


class JobRequestBase(Value):
    """Base class of job requests: priority, time limit and worker requirements."""

    priority: int = Field(default=DEFAULT_PRIORITY, ge=0, le=LOWEST_PRIORITY, description="Smaller ones run first")
    timeout: float | None = Field(default=None, gt=0, le=30 * 86_400, description="Longest it may run (s)")
    requires: Required = Field(default=Required(), description="Capabilities required of the worker")


class Through(Value):
    """Mask for retrospective undersampling: the scan is reconstructed from the points of this mask alone."""

    mask_id: Identifier = Field(description="Identifier of the mask")
    points: Literal["nearest", "exact"] = Field(
        default="nearest", description="nearest: the measured point nearest to each of the mask's; exact: the same ones"
    )


class OfFrames(JobRequestBase):
    """Base class of job requests that select frames of a scan by number, wavelength or average."""

    frame: int | None = Field(
        default=None,
        ge=0,
        description="Which frame of a scan that has several; by default the first, with a note",
    )
    wavelength: float | None = quantity_field(
        "m", "Of the excitation: its first frame, or with average the mean of its frames", default=None, gt=0, le=1e-5
    )
    average: bool = Field(
        default=False, description="The mean of all frames, or of those at the wavelength; they must have one"
    )

    @property
    def frames(self) -> FrameChoice:
        """Selection of the scan's frames that are reconstructed."""
        return FrameChoice(self.frame, self.wavelength, self.average)


class ReconstructionRequest(OfFrames):
    """Request of a reconstruction: complete, live (following a running scan) or with another mask."""

    model_config = ConfigDict(json_schema_extra={"examples": RECONSTRUCTION_EXAMPLES})

    scan_id: Identifier = Field(description="Identifier of the scan")
    parameters: ReconstructionParameters = ReconstructionParameters()
    follow: bool = Field(
        default=False,
        description="Start while the scan runs: a revision every few seconds, the complete image at its end",
    )
    interval: float = quantity_field("s", "Between two revisions while following", ge=0.2, le=3600, default=2.0)
    through: Through | None = Field(default=None, description="Another mask, of a scan that is over")

    @model_validator(mode="after")
    def _check(self) -> Self:
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
        FrameChoice(self.frame, self.wavelength, self.average)
        return self

    @property
    def kind(self) -> Literal["reconstruction", "live", "what-if"]:
        """Job kind that follows from the request: reconstruction, live or what-if."""
        return "live" if self.follow else "reconstruction" if self.through is None else "what-if"


class SoundSpeedRequest(JobRequestBase):
    """Request to find the speed of sound at which a scan's image is sharpest."""

    model_config = ConfigDict(json_schema_extra={"examples": [EXAMPLES["sound-speed"]]})

    kind: Literal["sound-speed"] = "sound-speed"
    scan_id: Identifier = Field(description="Identifier of the scan")
    first: float = quantity_field("m/s", "Lowest speed tried", **SOUND_SPEED.limits)
    last: float = quantity_field("m/s", "Highest speed tried", **SOUND_SPEED.limits)
    steps: int = quantity_field("speeds", "How many are tried, evenly spaced", ge=3, le=200, default=21)
    parameters: ReconstructionParameters = ReconstructionParameters()

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.last <= self.first:
            raise InvalidInput("last", self.last, f"> first, {self.first:g} (m/s)")
        if (layers := self.parameters.medium) is not None:
            raise InvalidInput("parameters.medium", f"{len(layers)} layers", "none: the search is for one speed")
        return self


class QualityRequest(JobRequestBase):
    """Request to compare a reconstruction with a reference reconstruction."""

    model_config = ConfigDict(json_schema_extra={"examples": [EXAMPLES["quality"]]})

    kind: Literal["quality"] = "quality"
    reconstruction_id: Identifier = Field(description="Identifier of the reconstruction that is judged")
    reference_id: Identifier = Field(description="Identifier of the reference reconstruction, with the same voxels")
    diameter: float | None = quantity_field(
        "m", "Of the disc around the axis that counts; none: everything", default=None, **LENGTH.limits
    )
    threshold: float = quantity_field(
        "share", "Of the reference's maximum, from which a voxel is of interest", ge=0, lt=1, default=0.04
    )


Place: TypeAlias = Annotated[tuple[float, ...], Field(min_length=3, max_length=3)]


class WidthRequest(OfFrames):
    """Request to measure an object's width in a reconstruction, corrected for the point spread."""

    model_config = ConfigDict(json_schema_extra={"examples": [EXAMPLES["width"]]})

    kind: Literal["width"] = "width"
    scan_id: Identifier = Field(description="Identifier of the scan that the reconstruction was made of")
    reconstruction_id: Identifier = Field(description="Identifier of the reconstruction, of a plane of sensors")
    start: Place = Field(description="x, y, z of the start of a line across the object (m)")
    end: Place = Field(description="x, y, z of its end (m)")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.start == self.end:
            raise InvalidInput("end", self.end, "another place than start")
        FrameChoice(self.frame, self.wavelength, self.average)
        return self


class ExportRequest(JobRequestBase):
    """Request to export a reconstruction or scan to a file format of other programs."""

    model_config = ConfigDict(json_schema_extra={"examples": [EXAMPLES["export"]]})

    kind: Literal["export"] = "export"
    reconstruction_id: Identifier | None = Field(default=None, description="Identifier of the reconstruction")
    scan_id: Identifier | None = Field(default=None, description="Identifier of the scan, instead")
    format: Format = Field(
        description=f"{' and '.join(SCAN_FORMATS)} are for scans, all others are for reconstructions"
    )
    frame: int | None = Field(default=None, ge=0, description="Which frame goes into an .sgl file, which holds one")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.reconstruction_id is None) == (self.scan_id is None):
            raise InvalidInput("reconstruction_id", self.reconstruction_id, "this one or scan_id, not both")
        formats = VOLUME_FORMATS if self.scan_id is None else SCAN_FORMATS
        if self.format not in formats:
            raise InvalidInput("format", self.format, ", ".join(formats))
        return self


class ImportRequest(JobRequestBase):
    """Request to import an uploaded file as a scan."""

    model_config = ConfigDict(json_schema_extra={"examples": [EXAMPLES["import"]]})

    kind: Literal["import"] = "import"
    upload_id: Identifier = Field(description="Identifier of the upload")
    description: dict[str, Any] | None = Field(
        default=None, description="Values that are not in the file: sampling_interval, positions, sound_speed, …"
    )
    companion_id: Identifier | None = Field(
        default=None, description="Identifier of an upload with the positions (csv, npy) or of k-Wave's input file"
    )
    labels: dict[Name, Text] = Field(default_factory=dict, max_length=50, description="Labels of the scan")

    @model_validator(mode="after")
    def _check(self) -> Self:
        check_described(self.description)
        return self


def check_described(description: dict[str, Any] | None) -> None:
    """Reject an import description whose positions are a file path, because paths refer to the service's host."""
    if isinstance((description or {}).get("positions"), str):
        raise InvalidInput("description.positions", "a name", "numbers, or a file sent as companion_id")


WorkRequest: TypeAlias = SoundSpeedRequest | QualityRequest | WidthRequest | ExportRequest | ImportRequest
"""What may be asked for as a job of its own; reconstructions are resources of their own."""


def to_job_request(
    job_id: str,
    request: ReconstructionRequest | WorkRequest,
    *,
    principal: str = "local",
    batch_id: str | None = None,
    simulated: bool = False,
    memory: int = 0,
) -> JobRequest:
    """Convert an API request to a job for the queue; ``memory`` is a lower bound of the required bytes."""
    payload = request.model_dump(mode="json")
    if request.requires == Required():
        del payload["requires"]  # the default
    return JobRequest(
        job_id,
        request.kind,
        stored(payload),
        request.priority,
        request.timeout,
        principal,
        batch_id,
        simulated,
        Requirements(
            memory=max(memory, request.requires.memory or 0),
            cores=request.requires.cores or 0,
            gpu=isinstance(request, ReconstructionRequest) and request.parameters.device == "gpu",
        ),
    )
