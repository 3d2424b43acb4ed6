"""``/reconstructions``: jobs that turn a scan into a volume."""

from __future__ import annotations

from typing import Literal

from fastapi import APIRouter, Request, Response
from pydantic import ConfigDict, Field
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
    final_response,
    set_next_link,
)
from steradian.api.params.filters import BatchIdFilter, JobStates, ScanIdFilter, ThroughMaskIdFilter, VolumeKind
from steradian.api.params.path import RECONSTRUCTION_ID
from steradian.api.schemas.jobs import ReconstructionView
from steradian.api.schemas.resources import Listing
from steradian.api.services import ServiceContainer
from steradian.api.use_cases.submission import submit_reconstruction
from steradian.core.validation import Value
from steradian.jobs.job import LOWEST_PRIORITY, JobStatus
from steradian.jobs.queue.job_ledger import to_status
from steradian.jobs.reconstruction_request import ReconstructionRequest
from steradian.storage.repositories import filters

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
    """Queue a reconstruction; with an Idempotency-Key a repeated request receives the first response.

    With ``follow`` it begins while the scan runs; with ``through`` it shows what another mask would have seen.
    """

    def read(identifier: str) -> tuple[ReconstructionView, bool]:
        view = ReconstructionView.of(services.ledger.reconstruction(identifier))
        return view, view.is_over

    answer = await run_in_threadpool(submit_reconstruction, services, who, wanted, key)
    return await final_response(answer, wait, read)


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
    page = services.ledger.page(limit, before, where)
    set_next_link(response, request, limit, page.cursor)
    return Listing(items=[ReconstructionView.of(to_status(row)) for row in page.rows])


@router.get("/{reconstruction_id}", summary="One reconstruction")
async def read_reconstruction(
    services: ServicesDep, reconstruction_id: RECONSTRUCTION_ID, wait: Wait, conditions: ReadPreconditionsDep
) -> ReconstructionView:
    """Return a reconstruction: its request, progress and report."""
    job = await read_with_wait(services, reconstruction_id, wait)
    view = ReconstructionView.of(job, await run_in_threadpool(services.forecast, job))
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
    """Change the priority of a queued reconstruction; with If-Match only if it has not changed since."""
    services.ledger.reconstruction(reconstruction_id)
    revision = conditions.revision(reconstruction_id)
    job = services.queue.set_priority(reconstruction_id, wanted.priority, revision, who.name)
    view = ReconstructionView.of(job, services.forecast(job))
    conditions.tag(resource_etag(reconstruction_id, job.revision, view))
    return view


async def read_with_wait(services: ServiceContainer, identifier: str, wait: Wait) -> JobStatus:
    """Read a reconstruction, with long polling if the client requested it."""
    return await wait.wait_for(lambda: services.ledger.reconstruction(identifier), lambda seen: seen.is_over)
