"""``/reconstructions``: jobs that turn a scan into a volume."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal, Self

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy.orm import Session
from starlette.concurrency import run_in_threadpool

from steradian.api.http.conditional import ReadPreconditionsDep, WritePreconditionsDep, resource_etag
from steradian.api.middleware.authentication import V1, AuthorizedRoute
from steradian.api.params.dependencies import (
    CurrentPrincipal,
    Limit,
    OptionalIdempotencyKey,
    PageCursor,
    ServicesDep,
    Wait,
    deleted_since,
    idempotent_response,
    set_next_link,
)
from steradian.api.params.filters import BatchIdFilter, JobStates, ScanIdFilter, ThroughMaskIdFilter, VolumeKind
from steradian.api.params.path import RECONSTRUCTION_ID
from steradian.api.schemas.reports import AttemptView
from steradian.api.schemas.resources import Listing, ReconstructionView
from steradian.api.services import ServiceContainer
from steradian.api.use_cases.admission import ResourceEstimate, check_reconstruction, estimate_resources
from steradian.core.validation import Value
from steradian.jobs.model import LOWEST_PRIORITY, JobStatus
from steradian.jobs.queue.ledger import to_status
from steradian.jobs.requests import ReconstructionRequest, to_job_request
from steradian.security.keys import Principal
from steradian.storage.db.tables import BatchRow, JobRow, ReconstructionRow, ScanRow
from steradian.storage.repositories import filters
from steradian.storage.repositories.idempotency import StoredResponse
from steradian.storage.repositories.references import lock_references

router = APIRouter(prefix=f"{V1}/reconstructions", tags=["reconstructions"], route_class=AuthorizedRoute)


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
    services: ServicesDep, who: CurrentPrincipal, wanted: ReconstructionRequest, key: OptionalIdempotencyKey, wait: Wait
) -> Response:
    """Queue a reconstruction; with an Idempotency-Key a repeated request gets the first one's answer.

    With ``follow`` it begins while the scan runs; with ``through`` it shows what another mask would have seen.
    """

    def make(session: Session) -> StoredResponse:
        services.require_disk_space(session, cost.disk, "the volume", measured)
        lock_references(session, wanted.model_dump(mode="json"))
        row, job = create_rows(services, session, scan, wanted, who, cost)
        view = ReconstructionView.of(row, to_status(job))
        return StoredResponse(202, view.links["self"], view.model_dump_json())

    answer = await run_in_threadpool(services.answers.get, key)
    if answer is None:
        scan = await run_in_threadpool(check_reconstruction, services, wanted)
        cost = await run_in_threadpool(estimate_resources, services, scan, wanted)
        measured = await run_in_threadpool(services.refresh_disk_usage)
        answer = await run_in_threadpool(services.answers.run_once, key, make)
    identifier = answer.location.rpartition("/")[2]
    if not wait.seconds:
        return idempotent_response(answer)
    with deleted_since(answer):
        row, job = await read_with_wait(services, identifier, wait)
        view, status = ReconstructionView.of(row, job), 201 if job.is_over else 202
        answer = replace(answer, status=status, location=view.links["self"], body=view.model_dump_json())
    return idempotent_response(answer)


@router.get("", summary="Reconstructions, newest first")
def list_reconstructions(
    services: ServicesDep,
    request: Request,
    response: Response,
    state: JobStates = None,
    kind: VolumeKind = None,
    scan_id: ScanIdFilter = None,
    batch_id: BatchIdFilter = None,
    mask_id: ThroughMaskIdFilter = None,
    limit: Limit = 100,
    before: PageCursor = None,
) -> Listing[ReconstructionView]:
    """List reconstructions."""
    where = filters.reconstructions(state=state, kind=kind, scan_id=scan_id, batch_id=batch_id, mask_id=mask_id)
    page = services.reconstructions.page(limit, before, where)
    set_next_link(response, request, limit, page.cursor)
    jobs = services.ledger.statuses([row.id for row in page.rows])
    return Listing(items=[ReconstructionView.of(row, jobs[row.id]) for row in page.rows if row.id in jobs])


@router.get("/{reconstruction_id}", summary="One reconstruction")
async def read_reconstruction(
    services: ServicesDep, reconstruction_id: RECONSTRUCTION_ID, wait: Wait, conditions: ReadPreconditionsDep
) -> ReconstructionView:
    """Show a reconstruction."""
    row, job = await read_with_wait(services, reconstruction_id, wait)
    view = ReconstructionView.of(row, job, await run_in_threadpool(services.forecast, job))
    conditions.tag(resource_etag(reconstruction_id, job.revision, view))
    return view


@router.patch("/{reconstruction_id}", summary="Move a waiting reconstruction in the queue")
def change_reconstruction(
    services: ServicesDep,
    who: CurrentPrincipal,
    reconstruction_id: RECONSTRUCTION_ID,
    wanted: PriorityChange,
    conditions: WritePreconditionsDep,
) -> ReconstructionView:
    """Give a reconstruction that waits another priority; with If-Match only if it has not changed since."""
    row = services.reconstructions.get(reconstruction_id)
    job = services.queue.set_priority(row.id, wanted.priority, conditions.revision(row.id), who.name)
    view = ReconstructionView.of(row, job, services.forecast(job))
    conditions.tag(resource_etag(row.id, job.revision, view))
    return view


@router.put("/{reconstruction_id}/desired-state", summary="Cancel a reconstruction", deprecated=True)
def set_reconstruction_desired_state(
    services: ServicesDep, who: CurrentPrincipal, reconstruction_id: RECONSTRUCTION_ID, wanted: JobWish
) -> ReconstructionView:
    """Do the same as PUT /jobs/{id}/desired-state, which is the address for every kind of job."""
    row = services.reconstructions.get(reconstruction_id)
    return ReconstructionView.of(row, services.cancel(row.id, who.name, wanted.reason))


@router.get("/{reconstruction_id}/attempts", summary="Every start of the job", deprecated=True)
def read_reconstruction_attempts(services: ServicesDep, reconstruction_id: RECONSTRUCTION_ID) -> AttemptsView:
    """Show the same as GET /jobs/{id}/attempts, which is the address for every kind of job."""
    services.reconstructions.get(reconstruction_id)
    return AttemptsView.of(services.ledger.status(reconstruction_id))


async def read_with_wait(
    services: ServiceContainer, identifier: str, wait: Wait
) -> tuple[ReconstructionRow, JobStatus]:
    """Read a reconstruction and its job, with long polling if the client requested it."""

    def read() -> tuple[ReconstructionRow, JobStatus]:
        return services.reconstructions.get(identifier), services.ledger.status(identifier)

    return await wait.wait_for(read, lambda seen: seen[1].is_over)


def create_rows(
    services: ServiceContainer,
    session: Session,
    scan: ScanRow,
    wanted: ReconstructionRequest,
    who: Principal,
    cost: ResourceEstimate,
    batch: BatchRow | None = None,
) -> tuple[ReconstructionRow, JobRow]:
    """Insert a reconstruction and its job, in the transaction that locks their dependencies."""
    row = services.reconstructions.add(session, scan, wanted.parameters.model_dump(mode="json"), batch)
    about: dict[str, Any] = {"principal": who.name, "batch_id": row.batch_id, "promised": cost.disk}
    job = services.submit(session, to_job_request(row.id, wanted, memory=cost.memory, **about))
    session.flush()
    return row, job
