"""Response schema of jobs of all kinds."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Self

from pydantic import BaseModel, Field

from steradian.api.http.urls import link
from steradian.api.schemas.queue import QueueView, RequirementsView
from steradian.api.schemas.reports import HistoryView, Result, result_of
from steradian.api.schemas.resources import ErrorView, ProgressView, RequestId
from steradian.jobs.job import JobStatus
from steradian.jobs.queue.estimates import QueueEstimate
from steradian.jobs.registry import resource_of
from steradian.jobs.request_versions import asked
from steradian.storage.state_machines import DesiredJobState, ReconstructionState, is_terminal


class JobView(BaseModel):
    """Job of any kind: its request, progress and results."""

    id: str
    kind: str = Field(examples=["export"])
    asked: dict[str, Any] = Field(description="Requested parameters", examples=[{"format": "nifti"}])
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
    result: Result | None = Field(description="Result, when it has succeeded; its fields depend on the kind")
    files: list[str] = Field(description="Names of the files it left, behind links.files", examples=[["volume.nii.gz"]])
    created: datetime | None
    started: datetime | None
    ended: datetime | None
    history: list[HistoryView] = Field(description="Every change of state, oldest first")
    links: dict[str, str] = Field(examples=[{"self": "/api/v1/…"}])

    @classmethod
    def of(cls, job: JobStatus, queue: QueueEstimate | None = None) -> Self:
        """Return the view of a job with its queue position."""
        here = link(f"/jobs/{job.id}")
        result = {name: value for name, value in job.result.items() if name != "files"}
        return cls(
            id=job.id,
            kind=job.kind,
            asked=asked(job.payload),
            priority=job.priority,
            turn=job.turn,
            requires=RequirementsView.of(job.requires),
            queue=QueueView.of(queue),
            state=job.state,
            desired_state=job.desired_state,
            reason=job.reason,
            attempt=job.attempt,
            progress=ProgressView(stage=job.stage, done=job.done, total=job.total),
            error=ErrorView(code=job.error_code, detail=job.error or "") if job.error_code else None,
            request_id=job.request_id,
            result=result_of(job.kind, result),
            files=[str(name) for name in job.result.get("files", [])],
            created=job.created,
            started=job.started,
            ended=job.ended,
            history=[HistoryView.model_validate(change) for change in job.history],
            links={"self": here}
            | {name: f"{here}/{name}" for name in ("log", "attempts", "desired-state")}
            | _links(here, job),
        )

    @property
    def is_over(self) -> bool:
        """Whether the job has ended, so that its state no longer changes."""
        return is_terminal(self.state)


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
