"""Response schemas of jobs of all kinds, and of reconstructions, which are jobs that write a volume."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Self

from pydantic import BaseModel, Field

from steradian.api.http.urls import link
from steradian.api.schemas.queue import QueueView, RequirementsView
from steradian.api.schemas.reports import HistoryView, ReportView, Result, result_of
from steradian.api.schemas.resources import ErrorView, ProgressView, RequestId
from steradian.jobs.job import JobStatus
from steradian.jobs.queue.estimates import QueueEstimate
from steradian.jobs.registry import LIVE_KIND, resource_of
from steradian.jobs.request_versions import asked
from steradian.storage.state_machines import DesiredJobState, ReconstructionState, is_terminal


class JobBase(BaseModel):
    """Fields that jobs have as jobs and as reconstructions: place in the queue, state and progress."""

    id: str
    priority: int = Field(description="Smaller values run first; among equal values, callers take turns")
    turn: int = Field(description="Among jobs of equal priority, smaller turns run first, equal ones by age")
    requires: RequirementsView
    queue: QueueView | None = Field(description="Of one that waits or runs, where it alone is read; not in lists")
    state: ReconstructionState
    desired_state: DesiredJobState
    reason: str | None = Field(description="Why it was cancelled")
    attempt: int = Field(description="1 for the first start, 0 before it")
    progress: ProgressView
    error: ErrorView | None
    request_id: RequestId
    created: datetime | None
    started: datetime | None
    ended: datetime | None
    history: list[HistoryView] = Field(description="Every change of state, oldest first")
    links: dict[str, str] = Field(examples=[{"self": "/api/v1/…"}])

    @property
    def is_over(self) -> bool:
        """Whether the job has ended, so that its state no longer changes."""
        return is_terminal(self.state)


class JobView(JobBase):
    """Job of any kind: its request, progress and results."""

    kind: str = Field(examples=["export"])
    asked: dict[str, Any] = Field(description="Requested parameters", examples=[{"format": "nifti"}])
    result: Result | None = Field(description="Result, when it has succeeded; its fields depend on the kind")
    files: list[str] = Field(description="Names of the files it left, behind links.files", examples=[["volume.nii.gz"]])

    @classmethod
    def of(cls, job: JobStatus, queue: QueueEstimate | None = None) -> Self:
        """Return the view of a job with its queue position."""
        result = {name: value for name, value in job.result.items() if name != "files"}
        here = link(f"/jobs/{job.id}")
        return cls(
            **_common(job, queue),
            kind=job.kind,
            asked=asked(job.payload),
            result=result_of(job.kind, result),
            files=[str(name) for name in job.result.get("files", [])],
            links={"self": here} | _parts(here) | _links(here, job),
        )


class ReconstructionView(JobBase):
    """Reconstruction: its request and progress."""

    kind: str = Field(
        description="reconstruction, live (follows its scan), what-if or unmixing (maps of a series)",
        examples=["reconstruction"],
    )
    scan_id: str
    batch_id: str | None = Field(description="The batch it belongs to")
    mask_id: str | None = Field(description="Mask of a what-if's subset")
    reconstruction_id: str | None = Field(default=None, description="Series that was unmixed")
    unmixing: dict[str, Any] | None = Field(default=None, description="Requested options of an unmixing")
    frame: int | None = Field(description="Which frame of the scan, if it has several; null: all, as a series")
    wavelength: float | None = Field(default=None, description="Excitation wavelength chosen, in m")
    average: bool = Field(default=False, description="Whether it is made of means of frames")
    align: bool = Field(default=False, description="Whether shifts between the volumes of a series are undone")
    motion: bool = Field(default=False, description="Whether motion within each frame is undone")
    simulated: bool = Field(description="Whether the scan came from a simulated scanner")
    parameters: dict[str, Any] = Field(description="Requested parameters; after success, the effective ones")
    report: ReportView | None = Field(description="Figures and provenance, when it has succeeded")
    created: datetime

    @classmethod
    def of(cls, job: JobStatus, queue: QueueEstimate | None = None) -> Self:
        """Return the view of a job that writes a volume, with its queue position."""
        here, job_at = link(f"/reconstructions/{job.id}"), link(f"/jobs/{job.id}")
        parts = {name: f"{here}/{name}" for name in ("volume", "quality")}
        if not (is_series := bool(job.result.get("frames"))):  # each of its volumes has an address by its index
            parts["ome_zarr"] = f"{here}/volume.ome.zarr"
        if job.kind == LIVE_KIND:
            parts["revision"] = f"{here}/revision"
        axes = ("z",) if is_series else ("x", "y", "z", "depth")
        mips = {f"mip_{axis}": f"{here}/mip?axis={axis}" for axis in axes}
        return cls(
            **_common(job, queue),
            kind=job.kind,
            scan_id=job.payload["scan_id"],
            batch_id=job.batch_id,
            mask_id=(job.payload.get("through") or {}).get("mask_id"),
            reconstruction_id=job.payload.get("reconstruction_id"),
            unmixing=job.payload.get("unmixing"),
            frame=job.payload.get("frame"),
            wavelength=job.payload.get("wavelength"),
            average=job.payload.get("average", False),
            align=job.payload.get("align", False),
            motion=job.payload.get("motion", False),
            simulated=job.simulated,
            parameters=job.result.get("parameters") or job.payload.get("parameters", {}),
            report=ReportView.model_validate(job.result) if job.result else None,
            links={"self": here, "scan": link(f"/scans/{job.scan_id}"), "job": job_at}
            | (parts | _parts(job_at) | mips),
        )


def _common(job: JobStatus, queue: QueueEstimate | None) -> dict[str, Any]:
    """Return the values of the fields of :class:`JobBase` except the links."""
    return {
        "id": job.id,
        "priority": job.priority,
        "turn": job.turn,
        "requires": RequirementsView.of(job.requires),
        "queue": QueueView.of(queue),
        "state": job.state,
        "desired_state": job.desired_state,
        "reason": job.reason,
        "attempt": job.attempt,
        "progress": ProgressView(stage=job.stage, done=job.done, total=job.total),
        "error": ErrorView(code=job.error_code, detail=job.error or "") if job.error_code else None,
        "request_id": job.request_id,
        "created": job.created,
        "started": job.started,
        "ended": job.ended,
        "history": [HistoryView.model_validate(change) for change in job.history],
    }


def _parts(here: str) -> dict[str, str]:
    return {name: f"{here}/{name}" for name in ("log", "attempts", "desired-state")}


def _links(here: str, job: JobStatus) -> dict[str, str]:
    links = {f"file:{name}": f"{here}/files/{name}" for name in job.result.get("files", [])}
    if resource_of(job.kind) == "reconstruction":
        links["reconstruction"] = link(f"/reconstructions/{job.id}")
    through, made = job.payload.get("through") or {}, job.result if job.kind == "import" else {}
    named = {**job.payload, **through, **made}
    for name, noun in (("scan_id", "scans"), ("reconstruction_id", "reconstructions"), ("mask_id", "masks")):
        if identifier := named.get(name):
            links.setdefault(name.removesuffix("_id"), link(f"/{noun}/{identifier}"))
    return links
