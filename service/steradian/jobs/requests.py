"""Request models of all job kinds; used as HTTP body, stored payload and handler argument.

One model all the way. Jobs name resources by identifier; where their files lie follows from the data directory of
whoever runs them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Self, TypeAlias

from pydantic import ConfigDict, Field, model_validator

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import LENGTH, SEARCH_SPAN, SEARCHED_SPEEDS, SOUND_SPEED
from steradian.core.validation import quantity_field
from steradian.jobs.figure_request import FIGURE_EXAMPLE, FigureRequest
from steradian.jobs.job import JobRequest, Requirements
from steradian.jobs.reconstruction_request import ReconstructionRequest
from steradian.jobs.request_base import Identifier, JobRequestBase, Name, OfFrames, Required, Text, index_field
from steradian.jobs.request_versions import stored
from steradian.reconstructions.exporting import FORMATS as VOLUME_FORMATS
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.studies.medium_unknowns import check_search
from steradian.scans.exporting import FORMATS as SCAN_FORMATS
from steradian.scans.frames import FrameChoice

SUFFIXES: Final[dict[str, str]] = {name: entry.suffix for name, entry in VOLUME_FORMATS.items()} | {
    name: endings[0] for name, endings in SCAN_FORMATS.items()
}
"""Endings of exported files by format, of volumes and scans."""
if TYPE_CHECKING:
    from steradian.quality import RegionOfInterest

    Format: TypeAlias = str
else:
    Format = Literal[tuple(SUFFIXES)]
EXAMPLES: dict[str, Any] = {
    "sound-speed": {"kind": "sound-speed", "scan_id": "s01jz0000000000000000000000", "first": 1450, "last": 1550},
    "quality": {
        "kind": "quality", "reconstruction_id": "r01jz0000000000000000000000",
        "reference_id": "r01jz0000000000000000000001",
    },
    "width": {
        "kind": "width", "scan_id": "s01jz0000000000000000000000", "reconstruction_id": "r01jz0000000000000000000000",
        "start": [-1e-3, 0, 2.5e-3], "end": [1e-3, 0, 2.5e-3],
    },
    "regions": {
        "kind": "regions", "reconstruction_id": "r01jz0000000000000000000000", "fit": "step",
        "regions": [{"kind": "box", "name": "vessel", "ranges": [[-1e-3, 1e-3], [0, 1e-3], [2e-3, 3e-3]]}],
    },
    "figure": FIGURE_EXAMPLE,
    "export": {"kind": "export", "reconstruction_id": "r01jz0000000000000000000000", "format": "nifti"},
    "import": {"kind": "import", "upload_id": "u01jz0000000000000000000000", "labels": {"from": "k-Wave"}},
}  # fmt: skip
"""A request of each kind of job."""


class SoundSpeedRequest(JobRequestBase):
    """Request to find the speed of sound at which a scan's image is sharpest."""

    model_config = ConfigDict(json_schema_extra={"examples": [EXAMPLES["sound-speed"]]})

    kind: Literal["sound-speed"] = "sound-speed"
    scan_id: Identifier = Field(description="Identifier of the scan")
    first: float = quantity_field(
        "m/s", "Lowest speed tried, of one speed", default=SEARCHED_SPEEDS.low, **SOUND_SPEED.limits
    )
    last: float = quantity_field(
        "m/s", "Highest speed tried, of one speed", default=SEARCHED_SPEEDS.high, **SOUND_SPEED.limits
    )
    steps: int = quantity_field("speeds", "How many are tried, evenly spaced", ge=3, le=200, default=21)
    search: tuple[str, ...] | None = Field(
        default=None,
        description="Parameters of the medium to find: layer1.sound_speed (layer 1 is at the film), layer1.thickness, "
        "time_zero; none: the speeds of all layers of parameters.medium, or without layers one speed, first to last",
    )
    span: float = quantity_field(
        SEARCH_SPAN.unit, "Half-width of the range of each parameter of the medium", default=0.1, **SEARCH_SPAN.limits
    )
    parameters: ReconstructionParameters = ReconstructionParameters()

    @model_validator(mode="after")
    def _check(self) -> Self:
        check_search(self.search, len(self.parameters.medium or (None,)))
        if self.is_of_medium and (self.first, self.last) != (SEARCHED_SPEEDS.low, SEARCHED_SPEEDS.high):
            allowed = "none beside search or parameters.medium; span is their range"
            raise InvalidInput("first", f"{self.first:g}, last {self.last:g}", allowed)
        if self.last <= self.first:
            raise InvalidInput("last", self.last, f"> first, {self.first:g} (m/s)")
        return self

    @property
    def is_of_medium(self) -> bool:
        """Whether parameters of a medium are sought, instead of one speed from ``first`` to ``last``."""
        return self.search is not None or self.parameters.medium is not None


class QualityRequest(JobRequestBase):
    """Request to compare a reconstruction with a reference reconstruction."""

    model_config = ConfigDict(json_schema_extra={"examples": [EXAMPLES["quality"]]})

    kind: Literal["quality"] = "quality"
    reconstruction_id: Identifier = Field(description="Identifier of the reconstruction that is judged")
    reference_id: Identifier = Field(description="Identifier of the reference reconstruction, with the same voxels")
    index: int | None = index_field()
    reference_index: int | None = index_field("Which volume of a series as the reference, from 0")
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
    index: int | None = index_field("Which volume of a series, from 0; frame, wavelength and average follow from it")
    start: Place = Field(description="x, y, z of the start of a line across the object (m)")
    end: Place = Field(description="x, y, z of its end (m)")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.start == self.end:
            raise InvalidInput("end", self.end, "another place than start")
        FrameChoice(self.frame, self.wavelength, self.average)
        return self


class RegionsRequest(JobRequestBase):
    """Request to measure regions in all volumes of a series, or in a volume, and their courses over time."""

    model_config = ConfigDict(json_schema_extra={"examples": [EXAMPLES["regions"]]})

    kind: Literal["regions"] = "regions"
    reconstruction_id: Identifier = Field(description="Identifier of the series or reconstruction")
    regions: tuple[dict[str, Any], ...] = Field(
        min_length=1, max_length=50, description="Regions as in a file of regions: box, ellipsoid, polygon, … (m)"
    )
    background: dict[str, Any] | None = Field(default=None, description="Region for the contrast to noise")
    fit: Literal["step", "exponential"] | None = Field(default=None, description="Change over time that is fitted")

    @model_validator(mode="after")
    def _check(self) -> Self:
        regions, background = self.built()
        names = [region.name for region in (*regions, *([] if background is None else [background]))]
        if repeated := [name for name in names if names.count(name) > 1]:
            raise InvalidInput("regions", repeated[0], "another name for each region and the background")
        return self

    def built(self) -> tuple[list[RegionOfInterest], RegionOfInterest | None]:
        """Return the regions and the background; raises :class:`InvalidInput` for one that is out of range."""
        found = [_region(f"regions.{number}", each) for number, each in enumerate(self.regions)]
        return found, None if self.background is None else _region("background", self.background)


def _region(field: str, said: dict[str, Any]) -> RegionOfInterest:
    from steradian.quality.region_files import region_from_json

    try:
        return region_from_json(said)
    except InvalidInput as error:
        raise InvalidInput(f"{field}.{error.field.removeprefix('region.')}", error.value, error.allowed) from error


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
    index: int | None = index_field("Which volume of a series is exported, from 0; none: all in one file")

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


WorkRequest: TypeAlias = (
    SoundSpeedRequest | QualityRequest | WidthRequest | RegionsRequest | FigureRequest | ExportRequest | ImportRequest
)
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
