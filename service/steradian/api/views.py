"""What the resources look like in JSON."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Generic, Self, TypeVar

from pydantic import BaseModel, Field

from steradian.plans import VisitOrder
from steradian.storage.jobs import JobStatus
from steradian.storage.states import DesiredScanState, ReconstructionState, ScanState
from steradian.storage.tables import MaskRow, PlanRow, ReconstructionRow, ScanRow

BASE = "/api/v1"
Item = TypeVar("Item")


class Listing(BaseModel, Generic[Item]):
    """A page of resources, newest first."""

    items: list[Item]


class ProgressView(BaseModel):
    """How far work has come."""

    stage: str | None = Field(description="What is being done", examples=["A-lines"])
    done: int
    total: int = Field(description="In the same unit as done; 0 while unknown")


class ErrorView(BaseModel):
    """Why work failed."""

    code: str
    detail: str


class MaskView(BaseModel):
    """A mask without its points (see ``links.points``)."""

    id: str
    arrangement: dict[str, Any] = Field(description="Kind and parameters")
    aperture: float = Field(description="Side X of the square aperture (m)")
    depth: float | None = Field(description="Distance of the point of interest (m)")
    count: int = Field(description="Number of points")
    weight_ratio: float = Field(description="Largest over smallest weight")
    created: datetime
    links: dict[str, str]

    @classmethod
    def of(cls, row: MaskRow) -> Self:
        """Show a row."""
        here = f"{BASE}/masks/{row.id}"
        return cls(
            id=row.id,
            arrangement=row.arrangement,
            aperture=row.aperture,
            depth=row.depth,
            count=row.count,
            weight_ratio=row.weight_ratio,
            created=row.created,
            links={"self": here, "points": f"{here}/points"},
        )


class PointsView(BaseModel):
    """The points of a mask."""

    id: str
    count: int
    positions: list[list[float]] = Field(description="(count, 2) x, y in metres, centred on the aperture")
    weights: list[float] = Field(description="(count,) areas in m²")


class PlanView(BaseModel):
    """A plan and what it costs."""

    id: str
    mask_id: str
    pulse_rate: float = Field(description="Laser pulses per second (Hz)")
    averages: int
    samples: int
    sampling_interval: float = Field(description="s")
    sound_speed: float = Field(description="m/s")
    order: VisitOrder
    preview: dict[str, Any] = Field(description="laser_seconds (s), travel (m), bytes, findings")
    created: datetime
    links: dict[str, str]

    @classmethod
    def of(cls, row: PlanRow) -> Self:
        """Show a row."""
        links = {"self": f"{BASE}/plans/{row.id}", "mask": f"{BASE}/masks/{row.mask_id}"}
        return cls(
            id=row.id, mask_id=row.mask_id, preview=row.preview, created=row.created, links=links, **row.parameters
        )


class ScanView(BaseModel):
    """A scan: where it stands and what is wished of it."""

    id: str
    plan_id: str
    mask_id: str
    simulated: bool = Field(description="Whether the scanner is a simulation")
    state: ScanState
    desired_state: DesiredScanState
    reason: str | None = Field(description="Why another state was wished")
    progress: ProgressView
    error: ErrorView | None
    summary: dict[str, Any] | None = Field(description="points, fired, stored; when the scan is over")
    created: datetime
    started: datetime | None
    ended: datetime | None
    history: list[dict[str, Any]] = Field(description="state, at, why of every change")
    links: dict[str, str]

    @classmethod
    def of(cls, row: ScanRow) -> Self:
        """Show a row."""
        here = f"{BASE}/scans/{row.id}"
        return cls(
            id=row.id,
            plan_id=row.plan_id,
            mask_id=row.mask_id,
            simulated=row.simulated,
            state=row.state,
            desired_state=row.desired_state,
            reason=row.reason,
            progress=ProgressView(stage=row.stage, done=row.done or 0, total=row.total or 0),
            error=ErrorView(code=row.error_code, detail=row.error or "") if row.error_code else None,
            summary=row.summary,
            created=row.created,
            started=row.started,
            ended=row.ended,
            history=row.history,
            links={"self": here, "plan": f"{BASE}/plans/{row.plan_id}", "file": f"{here}/file"},
        )


class ReconstructionView(BaseModel):
    """A reconstruction: what was asked and how far it is."""

    id: str
    scan_id: str
    simulated: bool = Field(description="Whether the scan came from a simulated scanner")
    parameters: dict[str, Any]
    state: ReconstructionState
    desired_state: str = Field(description="succeeded, or cancelled when somebody asked for it")
    reason: str | None = Field(description="Why it was cancelled")
    attempt: int = Field(description="1 for the first start, 0 before it")
    progress: ProgressView
    error: ErrorView | None
    report: dict[str, Any] | None = Field(description="Figures and provenance, when it has succeeded")
    created: datetime
    started: datetime | None
    ended: datetime | None
    links: dict[str, str]

    @classmethod
    def of(cls, row: ReconstructionRow, job: JobStatus) -> Self:
        """Show a row and its job."""
        here = f"{BASE}/reconstructions/{row.id}"
        mips = {f"mip_{axis}": f"{here}/mip?axis={axis}" for axis in "xyz"}
        links = {"self": here, "scan": f"{BASE}/scans/{row.scan_id}", "volume": f"{here}/volume", "log": f"{here}/log"}
        return cls(
            id=row.id,
            scan_id=row.scan_id,
            simulated=row.simulated,
            parameters=row.parameters,
            state=job.state,
            desired_state="cancelled" if row.cancel_wanted else "succeeded",
            reason=row.cancel_reason,
            attempt=job.attempt,
            progress=ProgressView(stage=job.stage, done=job.done, total=job.total),
            error=ErrorView(code=job.error_code, detail=job.error or "") if job.error_code else None,
            report=job.result or None,
            created=row.created,
            started=job.started,
            ended=job.ended,
            links=links | mips,
        )
