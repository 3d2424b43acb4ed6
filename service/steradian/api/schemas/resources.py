"""Response schemas of masks, plans, scans and reconstructions."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING, Annotated, Any, Generic, Self, TypeAlias, TypeVar

from pydantic import BaseModel, Field

from steradian.api.http.urls import BASE as BASE
from steradian.api.http.urls import link
from steradian.api.schemas.reports import HistoryView, PreviewView, SummaryView
from steradian.api.schemas.scans import StageView
from steradian.plans import VisitOrder
from steradian.plans.stages import FocusStage, StoppingRule
from steradian.storage.db.tables import MaskRow, PlanRow, ScanRow
from steradian.storage.state_machines import DesiredScanState, ScanState

if TYPE_CHECKING:
    from steradian.masks import Mask
    from steradian.masks.metrics import MaskMetrics

Item = TypeVar("Item")
RequestId: TypeAlias = Annotated[
    str | None, Field(description="X-Request-ID of the request that asked for it; null: not known")
]


class Listing(BaseModel, Generic[Item]):
    """A page of resources, newest first."""

    items: list[Item]


class ProgressView(BaseModel):
    """Progress of a scan or job."""

    stage: str | None = Field(description="Current stage", examples=["A-lines"])
    done: int
    total: int = Field(description="In the same unit as done; 0 while unknown")


class ErrorView(BaseModel):
    """Error of a failed scan or job: code and detail."""

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
    sensed_area: float = Field(
        description="What the points stand for together, the sum of their weights (m², m for a line)"
    )
    created: datetime
    links: dict[str, str] = Field(examples=[{"self": "/api/v1/…"}])

    @classmethod
    def of(cls, row: MaskRow) -> Self:
        """Return the view of a mask from its row."""
        here = link(f"/masks/{row.id}")
        return cls(
            id=row.id,
            arrangement=row.arrangement,
            aperture=row.aperture,
            depth=row.depth,
            count=row.count,
            weight_ratio=row.weight_ratio,
            sensed_area=row.sensed_area,
            created=row.created,
            links={"self": here, "points": f"{here}/points", "picture": f"{here}/picture"},
        )


class MaskPreviewView(BaseModel):
    """Preview of a mask and its metrics, from its (first) point of interest; metrics are null where it has none."""

    id: str = Field(description="Identifier that it would have")
    arrangement: dict[str, Any] = Field(description="Kind and parameters")
    aperture: float = Field(description="Side X of the square aperture (m)")
    depth: float | None = Field(description="Distance of the point of interest (m)")
    count: int = Field(description="Number of points")
    weight_ratio: float = Field(description="Largest over smallest weight")
    sensed_area: float = Field(description="What the points stand for together (m², m for a line)")
    finest: float = Field(description="Least distance of a point to its nearest neighbour (m)")
    coarsest: float = Field(description="Greatest distance of a point to its nearest neighbour (m)")
    point_of_interest: list[float] | None = Field(description="x, y, z (m)", examples=[[0, 0, 3.6e-3]])
    evenness: float | None = Field(description="Deviation of the points' solid angles over their mean")
    largest_angle: float | None = Field(description="Greatest angle of incidence (rad)")
    opening_angle: float | None = Field(description="Under which the points appear, in the widest plane (rad)")
    attenuation_db: float | None = Field(description="What the film loses at the largest angle and 1 MHz (dB)")

    @classmethod
    def of(cls, mask: Mask, seen: MaskMetrics) -> Self:
        """Return the view of a mask and its metrics."""
        its = vars(seen) | {name: getattr(mask, name) for name in cls.model_fields if hasattr(mask, name)}
        place = None if seen.point_of_interest is None else list(seen.point_of_interest)
        return cls(**its | {"point_of_interest": place})


class PointsView(BaseModel):
    """Points of a mask with their weights."""

    id: str
    count: int
    positions: list[list[float]] = Field(description="(count, 2) x, y in metres, centred on the aperture")
    weights: list[float] = Field(description="(count,) areas in m², lengths in m for a line")
    sensed_area: float = Field(description="What the points stand for together, the sum of the weights (m², m)")
    outline: list[list[float]] | None = Field(
        description="(V, 2) corners of the sensed area in metres, (2, 1) for a line; null: not known"
    )


class PlanView(BaseModel):
    """Plan and its cost."""

    id: str
    mask_id: str
    pulse_rate: float = Field(description="Laser pulses per second (Hz)")
    averages: int
    samples: int
    sampling_interval: float = Field(description="s")
    sound_speed: float = Field(description="m/s")
    order: VisitOrder
    frames: int = Field(default=1, description="How often the mask is measured at each excitation wavelength")
    excitation: list[float] = Field(default_factory=list, description="Excitation wavelengths (m)", examples=[[7.5e-7]])
    gate: str = Field(default="none", description="What waits for an edge at the scanner's gate input: frame or point")
    gate_rate: float = Field(default=1.0, description="Expected edges a second (Hz)")
    max_sensitivity_loss: float = Field(default=0.0, description="Share a point may lose to save a retuning")
    wavelength_uncertainty: float = Field(default=0.0, description="Of the points' best wavelengths (m)")
    stages: list[FocusStage] = Field(default_factory=list, description="Further stages, made while it is measured")
    stage_ends: list[int] = Field(default_factory=list, description="Points at the end of each stage but the last")
    stopping: StoppingRule | None = Field(default=None, description="Rule that ends the scan early")
    beams: list[list[float]] = Field(
        default_factory=list,
        description="(B, 2) where each beam is beside the first (m)",
        examples=[[[0, 0], [8e-4, 0]]],
    )
    preview: PreviewView = Field(description="What it costs")
    created: datetime
    links: dict[str, str] = Field(examples=[{"self": "/api/v1/…"}])

    @classmethod
    def of(cls, row: PlanRow) -> Self:
        """Return the view of a plan from its row."""
        preview = PreviewView.model_validate(row.preview)
        links = {"self": link(f"/plans/{row.id}"), "mask": link(f"/masks/{row.mask_id}")}
        return cls(id=row.id, mask_id=row.mask_id, created=row.created, links=links, preview=preview, **row.parameters)


class ScanView(BaseModel):
    """Scan: its state and desired state."""

    id: str
    plan_id: str
    mask_id: str
    scanner_id: str | None = Field(description="Owner; null: imported")
    simulated: bool = Field(description="Whether the scanner is a simulation")
    state: ScanState
    desired_state: DesiredScanState
    reason: str | None = Field(description="Reason of the desired state")
    labels: dict[str, str] = Field(description="Texts of your own")
    stages: list[StageView] | None = Field(default=None, description="Of a scan in stages; null: there is one")
    completes: str | None = Field(description="Scan whose A-lines it starts with")
    fence: int = Field(description="Number of the scanner lease under which it was asked for")
    progress: ProgressView
    error: ErrorView | None
    request_id: RequestId
    summary: SummaryView | None = Field(description="When the scan is over")
    created: datetime
    started: datetime | None
    ended: datetime | None
    history: list[HistoryView] = Field(description="Every change of state, oldest first")
    links: dict[str, str] = Field(examples=[{"self": "/api/v1/…"}])

    @classmethod
    def of(cls, row: ScanRow) -> Self:
        """Return the view of a scan from its row."""
        here = link(f"/scans/{row.id}")
        parts = {name: f"{here}/{name}" for name in ("file", "shots", "alines", "coverage")}
        return cls(
            id=row.id,
            plan_id=row.plan_id,
            mask_id=row.mask_id,
            scanner_id=row.scanner_id,
            simulated=row.simulated,
            state=row.state,
            desired_state=row.desired_state,
            reason=row.reason,
            labels=row.labels,
            stages=None if row.stages is None else [StageView.model_validate(stage) for stage in row.stages],
            completes=row.completes,
            fence=row.fence,
            progress=ProgressView(stage=row.stage, done=row.done or 0, total=row.total or 0),
            error=ErrorView(code=row.error_code, detail=row.error or "") if row.error_code else None,
            request_id=row.request_id,
            summary=SummaryView.model_validate(row.summary) if row.summary else None,
            created=row.created,
            started=row.started,
            ended=row.ended,
            history=[HistoryView.model_validate(change) for change in row.history],
            links={"self": here, "plan": link(f"/plans/{row.plan_id}"), **parts},
        )
