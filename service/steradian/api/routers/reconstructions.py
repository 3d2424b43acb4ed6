"""``/reconstructions``: jobs that turn a scan into a volume."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal, Self

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy.orm import Session
from starlette.concurrency import run_in_threadpool

from steradian.api.http.conditional import ChangeConditionsNeeded, ConditionsNeeded, etag_of
from steradian.api.middleware.authentication import V1, GuardedRoute
from steradian.api.params.dependencies import (
    Before,
    Limit,
    OptionalKey,
    ServicesNeeded,
    Wait,
    Who,
    deleted_since,
    link_next,
    replay,
)
from steradian.api.params.filters import JobStates, OfBatch, OfScan, ThroughMask, VolumeKind
from steradian.api.params.path import RECONSTRUCTION_ID
from steradian.api.schemas.reports import AttemptView
from steradian.api.schemas.resources import Listing, ReconstructionView
from steradian.api.services import Services
from steradian.api.use_cases.admission import Cost, check_reconstruction, cost_of
from steradian.core.validation import Value
from steradian.jobs.model import LOWEST_PRIORITY, JobStatus
from steradian.jobs.queue.ledger import to_status
from steradian.jobs.requests import ReconstructionRequest, job_of
from steradian.security.keys import Principal
from steradian.storage.db.tables import BatchRow, JobRow, ReconstructionRow, ScanRow
from steradian.storage.repositories import filters
from steradian.storage.repositories.idempotency import Answer
from steradian.storage.repositories.references import hold_needs

router = APIRouter(prefix=f"{V1}/reconstructions", tags=["reconstructions"], route_class=GuardedRoute)


class PriorityChange(Value):
    """Change of a queued job's priority."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"priority": 10}]})

    priority: int = Field(ge=0, le=LOWEST_PRIORITY, description="Smaller ones run first")


class JobWish(Value):
    """Desired state of a job, as requested."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"state": "cancelled", "reason": "typo"}]})

    state: Literal["cancelled"]
    reason: str | None = Field(default=None, max_length=500)


class AttemptsView(BaseModel):
    """Every start of a job with its end."""

    items: list[AttemptView]

    @classmethod
    def of(cls, job: JobStatus) -> Self:
        """Show the starts of a job."""
        return cls(items=[AttemptView.model_validate(start) for start in job.attempts])


@router.post(
    "",
    status_code=202,
    summary="Queue a reconstruction of a scan",
    response_model=ReconstructionView,
    responses={201: {"model": ReconstructionView, "description": "It was over within the time waited for"}},
)
async def create_reconstruction(
    services: ServicesNeeded, who: Who, wanted: ReconstructionRequest, key: OptionalKey, wait: Wait
) -> Response:
    """Queue a reconstruction; with an Idempotency-Key a repeated request gets the first one's answer.

    With ``follow`` it begins while the scan runs; with ``through`` it shows what another mask would have seen.
    """

    def make(session: Session) -> Answer:
        services.require_room(session, cost.disk, "the volume", measured)
        hold_needs(session, wanted.model_dump(mode="json"))
        row, job = note_reconstruction(services, session, scan, wanted, who, cost)
        view = ReconstructionView.of(row, to_status(job))
        return Answer(202, view.links["self"], view.model_dump_json())

    answer = await run_in_threadpool(services.answers.kept, key)
    if answer is None:
        scan = await run_in_threadpool(check_reconstruction, services, wanted)
        cost = await run_in_threadpool(cost_of, services, scan, wanted)
        measured = await run_in_threadpool(services.measure)
        answer = await run_in_threadpool(services.answers.once, key, make)
    identifier = answer.location.rpartition("/")[2]
    if not wait.seconds:
        return replay(answer)
    with deleted_since(answer):
        row, job = await look(services, identifier, wait)
        view, status = ReconstructionView.of(row, job), 201 if job.is_over else 202
        answer = replace(answer, status=status, location=view.links["self"], body=view.model_dump_json())
    return replay(answer)


@router.get("", summary="Reconstructions, newest first")
def list_reconstructions(
    services: ServicesNeeded,
    request: Request,
    response: Response,
    state: JobStates = None,
    kind: VolumeKind = None,
    scan_id: OfScan = None,
    batch_id: OfBatch = None,
    mask_id: ThroughMask = None,
    limit: Limit = 100,
    before: Before = None,
) -> Listing[ReconstructionView]:
    """List reconstructions."""
    where = filters.reconstructions(state=state, kind=kind, scan_id=scan_id, batch_id=batch_id, mask_id=mask_id)
    page = services.reconstructions.page(limit, before, where)
    link_next(response, request, limit, page.cursor)
    jobs = services.ledger.statuses([row.id for row in page.rows])
    return Listing(items=[ReconstructionView.of(row, jobs[row.id]) for row in page.rows if row.id in jobs])


@router.get("/{reconstruction_id}", summary="One reconstruction")
async def read_reconstruction(
    services: ServicesNeeded, reconstruction_id: RECONSTRUCTION_ID, wait: Wait, conditions: ConditionsNeeded
) -> ReconstructionView:
    """Show a reconstruction."""
    row, job = await look(services, reconstruction_id, wait)
    view = ReconstructionView.of(row, job, await run_in_threadpool(services.forecast, job))
    conditions.tag(etag_of(reconstruction_id, job.revision, view))
    return view


@router.patch("/{reconstruction_id}", summary="Move a waiting reconstruction in the queue")
def change_reconstruction(
    services: ServicesNeeded,
    who: Who,
    reconstruction_id: RECONSTRUCTION_ID,
    wanted: PriorityChange,
    conditions: ChangeConditionsNeeded,
) -> ReconstructionView:
    """Give a reconstruction that waits another priority; with If-Match only if it has not changed since."""
    row = services.reconstructions.get(reconstruction_id)
    job = services.queue.set_priority(row.id, wanted.priority, conditions.revision(row.id), who.name)
    view = ReconstructionView.of(row, job, services.forecast(job))
    conditions.tag(etag_of(row.id, job.revision, view))
    return view


@router.put("/{reconstruction_id}/desired-state", summary="Cancel a reconstruction", deprecated=True)
def set_reconstruction_desired_state(
    services: ServicesNeeded, who: Who, reconstruction_id: RECONSTRUCTION_ID, wanted: JobWish
) -> ReconstructionView:
    """Do the same as PUT /jobs/{id}/desired-state, which is the address for every kind of job."""
    row = services.reconstructions.get(reconstruction_id)
    return ReconstructionView.of(row, services.cancel(row.id, who.name, wanted.reason))


@router.get("/{reconstruction_id}/attempts", summary="Every start of the job", deprecated=True)
def read_reconstruction_attempts(services: ServicesNeeded, reconstruction_id: RECONSTRUCTION_ID) -> AttemptsView:
    """Show the same as GET /jobs/{id}/attempts, which is the address for every kind of job."""
    services.reconstructions.get(reconstruction_id)
    return AttemptsView.of(services.ledger.status(reconstruction_id))


async def look(services: Services, identifier: str, wait: Wait) -> tuple[ReconstructionRow, JobStatus]:
    """Read a reconstruction and its job, with long polling if the client requested it."""

    def read() -> tuple[ReconstructionRow, JobStatus]:
        return services.reconstructions.get(identifier), services.ledger.status(identifier)

    return await wait.until(read, lambda seen: seen[1].is_over)


def note_reconstruction(
    services: Services,
    session: Session,
    scan: ScanRow,
    wanted: ReconstructionRequest,
    who: Principal,
    cost: Cost,
    batch: BatchRow | None = None,
) -> tuple[ReconstructionRow, JobRow]:
    """Insert a reconstruction and its job, in the transaction that locks their dependencies."""
    row = services.reconstructions.add(session, scan, wanted.parameters.model_dump(mode="json"), batch)
    about: dict[str, Any] = {"principal": who.name, "batch_id": row.batch_id, "promised": cost.disk}
    job = services.submit(session, job_of(row.id, wanted, memory=cost.memory, **about))
    session.flush()
    return row, job
