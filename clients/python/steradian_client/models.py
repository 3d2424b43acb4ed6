"""Typed responses of the service; unknown fields of a newer service become further attributes."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from pydantic import BaseModel, ConfigDict, Field


class ResponseModel(BaseModel):
    """Base class of all typed responses."""

    model_config = ConfigDict(frozen=True, extra="allow")


class Progress(ResponseModel):
    """Progress of a scan or job; ``total`` is 0 while unknown."""

    stage: str | None
    done: int
    total: int


class Problem(ResponseModel):
    """Error that made a scan or job fail: code and detail."""

    code: str
    detail: str


class Service(ResponseModel):
    """Service information: version, whether the scanner is simulated, and limits."""

    version: str
    mode: str
    limits: dict[str, float]
    formats: dict[str, list[str]]


class Storage(ResponseModel):
    """Bytes used in the service's data folder by category, and bytes available."""

    used_bytes: dict[str, int]
    free_bytes: int
    reserve_bytes: int
    available_bytes: int


class Health(ResponseModel):
    """Liveness of the service's process, and its version."""

    status: str
    version: str


class Readiness(ResponseModel):
    """Readiness checks by name; ``reasons`` explains failed ones."""

    ready: bool
    checks: dict[str, bool]
    reasons: dict[str, str] = Field(default_factory=dict)


class Mask(ResponseModel):
    """Mask with its parameters and metrics, without its points; lengths in metres."""

    id: str
    arrangement: dict[str, Any]
    aperture: float
    depth: float | None
    count: int
    weight_ratio: float
    sensed_area: float


class MaskPreview(ResponseModel):
    """Preview of a mask with its metrics; lengths in metres, angles in radians."""

    id: str
    arrangement: dict[str, Any]
    aperture: float
    depth: float | None
    count: int
    weight_ratio: float
    sensed_area: float
    finest: float
    coarsest: float
    point_of_interest: list[float] | None
    evenness: float | None
    largest_angle: float | None
    opening_angle: float | None
    attenuation_db: float | None


class Points(ResponseModel):
    """The points of a mask: positions (count, 2) in metres, weights in m² (m for a line)."""

    id: str
    count: int
    positions: list[list[float]]
    weights: list[float]
    sensed_area: float
    outline: list[list[float]] | None = None


class Plan(ResponseModel):
    """Scan plan and its cost; SI units."""

    id: str
    mask_id: str
    pulse_rate: float
    averages: int
    samples: int
    sampling_interval: float
    sound_speed: float
    order: str
    frames: int = 1
    excitation: list[float] = Field(default_factory=list)
    gate: str = "none"
    gate_rate: float = 1.0
    max_sensitivity_loss: float = 0.0
    wavelength_uncertainty: float = 0.0
    beams: list[list[float]] = Field(default_factory=list)
    stages: list[dict[str, Any]] = Field(default_factory=list)
    stage_ends: list[int] = Field(default_factory=list)
    stopping: dict[str, float | None] | None = None
    preview: dict[str, Any]


class Preview(ResponseModel):
    """Preview of a plan's cost: times, bytes and findings, as attributes."""


class DesignPreview(ResponseModel):
    """Preview of a mask and its plan: points, order, coverage seen from a point of interest, and cost."""

    mask: MaskPreview
    positions: list[list[float]]
    weights: list[float]
    solid_angles: list[float] | None
    visible_share: float | None
    visit: list[int]
    stages: list[int] = Field(default_factory=list)
    plan: Preview


class PointSpread(ResponseModel):
    """Image of a tiny ball (point-spread function): section (x, z) with peak 1, axes and widths in metres."""

    x: list[float]
    z: list[float]
    section: list[list[float]]
    lateral: float | None
    axial: float | None
    true_width: float
    background: float


class PulseSplit(ResponseModel):
    """Split of laser pulses between points and averages, with a vessel's expected contrast (dB) and widths (m)."""

    points: int
    averages: int
    seconds: float
    contrast_db: float
    side_lobes_db: float | None
    width: float | None
    width_scatter: float | None
    resolution: float | None
    usable: bool
    proposed: bool


class PulseBudget(ResponseModel):
    """Splits of a number of laser pulses for one arrangement and method."""

    pulses: int
    noise_db: float
    max_contrast_db: float
    modes: int
    splits: list[PulseSplit]


class QueuePosition(ResponseModel):
    """Queue position of a job that has not ended, and its expected end.

    ``awaited`` says which worker it waits for, where none that is present can do it.
    """

    position: int | None
    expected_end: datetime | None
    awaited: str | None = None


class LongRunning(ResponseModel):
    """Base class of resources that take time: scans, reconstructions and jobs."""

    id: str
    state: str
    progress: Progress
    error: Problem | None
    created: datetime | None
    started: datetime | None
    ended: datetime | None
    history: list[dict[str, Any]] = Field(default_factory=list)
    request_id: str | None = None

    @property
    def is_over(self) -> bool:
        """Whether the resource has ended."""
        return self.state in {"succeeded", "failed", "cancelled"}

    @property
    def succeeded(self) -> bool:
        """Whether the resource ended with a usable result."""
        return self.state == "succeeded"


class Scan(LongRunning):
    """Scan: its plan, state, progress and labels."""

    plan_id: str
    mask_id: str | None = None
    scanner_id: str | None = None
    simulated: bool
    desired_state: str | None = None
    reason: str | None = None
    labels: dict[str, str] = Field(default_factory=dict)
    stages: list[dict[str, Any]] | None = None
    completes: str | None = None
    fence: int | None = None
    summary: dict[str, Any] | None

    @property
    def is_over(self) -> bool:
        """Whether the scan has ended; an interrupted scan is resumed on request only."""
        return self.state in {"complete", "partial", "aborted", "failed", "interrupted"}

    @property
    def succeeded(self) -> bool:
        """Whether the scan ended with usable data: every point, or those measured before a stop."""
        return self.state in {"complete", "partial"}


class Signals(ResponseModel):
    """Statistics of a scan's A-lines before reconstruction; ``bad`` lists bad A-lines with their kind."""

    alines: int
    samples: int
    sampling_interval: float
    looked_at: int
    complete: bool
    decidable: bool
    histogram: dict[str, Any]
    spectrum: dict[str, list[float]]
    maps: dict[str, list[float | None]]
    beams: list[dict[str, Any]]
    frames: list[dict[str, Any]]
    bad: list[dict[str, Any]]
    bad_counts: dict[str, int]


class Shots(ResponseModel):
    """Metadata of each point's shot, in the order of the mask, frame after frame; columns of equal length.

    ``next`` is what to ask with as ``since``, to be told only what has changed; a service of before tells none.
    """

    points: list[int]
    frames: list[int]
    stored: list[bool]
    shot: list[int]
    quality: list[int]
    newest: int | None = None
    next: str | None = None


class Coverage(ResponseModel):
    """Share of the mask's points that are measured."""

    points: int
    stored: int
    missing: int
    flagged: int
    fired: int
    area_fraction: float


class Reconstruction(LongRunning):
    """Reconstruction job: its request and progress; ``report["frames"]`` lists the volumes of a series."""

    scan_id: str
    kind: str = "reconstruction"
    batch_id: str | None = None
    mask_id: str | None = None
    reconstruction_id: str | None = None
    unmixing: dict[str, Any] | None = None
    frame: int | None = None
    wavelength: float | None = None
    average: bool = False
    simulated: bool = False
    parameters: dict[str, Any]
    priority: int | None = None
    queue: QueuePosition | None = None
    attempt: int
    report: dict[str, Any] | None


class Revision(ResponseModel):
    """Intermediate image of a scan that is still running: number of points, coverage and quality."""

    number: int
    points: int
    planned: int
    final: bool
    coverage: dict[str, float]
    quality: dict[str, float | None]


class Quality(ResponseModel):
    """Result of comparing a reconstruction with a reference reconstruction."""

    reference_id: str
    diameter: float | None
    threshold: float
    state: str
    figures: dict[str, float | None] | None


class Measurement(ResponseModel):
    """Named measurement in a volume with its values; lengths in metres."""

    reconstruction_id: str
    measurement: dict[str, Any]
    figures: dict[str, float | None]
    ends: list[list[float]]
    reason: str
    state: str | None
    correction: dict[str, Any] | None


class Job(LongRunning):
    """Job of any kind: its request, progress, results and files."""

    kind: str
    asked: dict[str, Any]
    priority: int
    queue: QueuePosition | None = None
    attempt: int
    result: dict[str, Any] | None
    files: list[str]


class Attempt(ResponseModel):
    """Execution attempt of a job: number, worker and outcome."""

    number: int
    worker: str | None = None
    outcome: str | None = None
    detail: str | None = None


class BatchMember(ResponseModel):
    """Job of a batch: its varied parameters, and the figures of its report."""

    id: str
    varied: dict[str, Any]
    state: str
    progress: float
    figures: dict[str, Any] | None


class Batch(ResponseModel):
    """Batch of reconstructions: varied parameters, and its jobs with their states."""

    id: str
    scan_id: str
    vary: dict[str, Any]
    parameters: dict[str, Any]
    state: str
    counts: dict[str, int]
    jobs: list[BatchMember]
    created: datetime

    error: None = None

    @property
    def progress(self) -> Progress:
        """Number of ended jobs of the batch."""
        going = sum(self.counts.get(state, 0) for state in ("queued", "running", "cancelling"))
        total = sum(self.counts.values())
        return Progress(stage="jobs", done=total - going, total=total)

    @property
    def is_over(self) -> bool:
        """Whether all jobs of the batch have ended."""
        return self.state in {"succeeded", "failed", "cancelled", "forgotten"}

    @property
    def succeeded(self) -> bool:
        """Whether all jobs of the batch succeeded."""
        return self.state == "succeeded"


class Upload(ResponseModel):
    """Uploaded file that waits for its import."""

    id: str
    bytes: int
    length: int | None = None
    sha256: str | None = None


class MissingField(ResponseModel):
    """Metadata field that an import requires and the file lacks, with its allowed values."""

    field: str
    allowed: str


class UploadPreview(ResponseModel):
    """Preview of an import of a file, in SI units; ``None`` for fields that the file does not state."""

    format: str
    points: int
    frames: int
    samples: int
    dtype: str
    sampling_interval: float | None
    time_zero: float
    sound_speed: float | None
    aperture: float | None
    depth: float | None
    positions: list[list[float]] | None
    rows: list[int]
    traces: list[list[float]]
    missing: list[MissingField]
    notes: list[str] = []


class Lease(ResponseModel):
    """Lease of a scanner: holder and expiry; ``fence`` is its number (fencing token)."""

    holder: str
    principal: str
    note: str | None
    ends: datetime
    fence: int


class EmergencyStop(ResponseModel):
    """Active emergency stop of a scanner: time, person, and state of the laser.

    ``laser`` is off (the scanner itself said so), idle (there is no scanner) or unconfirmed: use the hardware switch.
    ``detail`` is what the scanner said, or why it could not be asked.
    """

    number: str
    at: datetime
    by: str
    reason: str | None
    laser: str
    detail: str | None = None
    seconds: float | None
    recorded: bool


class Fault(ResponseModel):
    """Latched fault of a scanner; ``clearable`` once its cause is removed."""

    code: int
    name: str
    title: str
    remedy: str
    clearable: bool


class Scanner(ResponseModel):
    """Scanner: its connection, the service's activity on it, and the device's reported state.

    What it says is ``age`` seconds old, and unknown when that is more than a second (ten for the scanner of another
    node): unknown is not off.
    """

    id: str
    simulated: bool
    model: str | None = None
    serial: str | None = None
    connection: str
    holder: str | None = None
    state: str
    laser: str = "unknown"
    shutter: str = "unknown"
    interlock: str = "unknown"
    key: str = "unknown"
    fault: Fault | None = None
    looked_at: datetime | None = None
    age: float | None = None
    look_interval: float | None = None
    since: datetime
    last_error: str | None
    lease: Lease | None
    emergency_stop: EmergencyStop | None


class Event(ResponseModel):
    """Event of the service's stream: a change of state, or progress.

    ``kind`` is scan, reconstruction, job, batch or scanner for a change of state; progress; ready when the stream
    stands (again); reset when the log does not go back to where it was left: read the resources again.
    """

    kind: str
    id: str | None
    data: dict[str, Any]

    @property
    def subject(self) -> str | None:
        """Identifier of the resource that the event concerns."""
        return self.data.get("id")
