"""``/jobs``: all jobs of the queue, and submission of sound-speed, quality, width, export, figure and import jobs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, TypeAlias

from fastapi import APIRouter, Body, Request, Response
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool

from steradian.api.errors.handlers import NotReady
from steradian.api.http.conditional import ReadPreconditionsDep, WritePreconditionsDep, etag_of_file, resource_etag
from steradian.api.http.file_response import RANGED, RangeFileResponse, concatenated_log_response, open_or_404
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
from steradian.api.params.filters import BatchIdFilter, JobKind, JobStates, ScanIdFilter
from steradian.api.params.path import FILE_NAME, JOB_ID
from steradian.api.routers.reconstructions import JobWish, PriorityChange
from steradian.api.schemas.jobs import JobView
from steradian.api.schemas.reports import AttemptView
from steradian.api.schemas.resources import Listing
from steradian.api.services import ServiceContainer
from steradian.api.use_cases.submission import submit_job
from steradian.core.exceptions import NotFound
from steradian.jobs.queue.job_ledger import to_status
from steradian.jobs.requests import EXAMPLES, WorkRequest
from steradian.security.keys import Principal
from steradian.storage.blobs.interface import result_name
from steradian.storage.data_dir.job_directory import LOG
from steradian.storage.repositories import filters
from steradian.storage.repositories.idempotency import IdempotencyKey
from steradian.storage.state_machines import ReconstructionState

router = APIRouter(prefix=f"{V1}/jobs", tags=["jobs"], route_class=AuthorizedRoute)


class AttemptsView(BaseModel):
    """All attempts of a job."""

    items: list[AttemptView]


AnyRequest: TypeAlias = Annotated[WorkRequest, Field(discriminator="kind")]
_EXAMPLES: dict[str, Any] = {kind: {"value": example} for kind, example in EXAMPLES.items()}


@router.post(
    "",
    status_code=202,
    summary="Queue a job other than a reconstruction",
    response_model=JobView,
    responses={201: {"model": JobView, "description": "It was over within the time waited for"}},
)
async def create_job(
    services: ServicesDep,
    who: CurrentPrincipal,
    wanted: Annotated[AnyRequest, Body(openapi_examples=_EXAMPLES)],
    key: OptionalIdempotencyKey,
    wait: Wait,
) -> Response:
    """Queue a job: sound-speed search, comparison, width, export or import, discriminated by ``kind``.

    Reconstructions, also those through another mask, are queued by POST /reconstructions and POST /batches.
    """
    return await submitted_job_response(services, who, wanted, key, wait)


async def submitted_job_response(
    services: ServiceContainer, principal: Principal, request: WorkRequest, key: IdempotencyKey | None, wait: Wait
) -> Response:
    """Submit a job and return its response; wait for the end of the job if the client requested that."""

    def read(identifier: str) -> tuple[JobView, bool]:
        view = JobView.of(services.ledger.status(identifier))
        return view, view.is_over

    answer = await run_in_threadpool(submit_job, services, principal, request, key)
    return await final_response(answer, wait, read)


@router.get("", summary="Jobs of every kind, newest first")
def list_jobs(
    services: ServicesDep,
    request: Request,
    response: Response,
    kind: JobKind = None,
    state: JobStates = None,
    scan_id: ScanIdFilter = None,
    batch_id: BatchIdFilter = None,
    limit: Limit = 100,
    before: PageCursor = None,
) -> Listing[JobView]:
    """List jobs of all kinds, including reconstructions."""
    where = filters.jobs(kind=kind, state=state, scan_id=scan_id, batch_id=batch_id)
    page = services.ledger.page(limit, before, where)
    set_next_link(response, request, limit, page.cursor)
    return Listing(items=[JobView.of(to_status(row)) for row in page.rows])


@router.get("/{job_id}", summary="One job")
async def read_job(services: ServicesDep, job_id: JOB_ID, wait: Wait, conditions: ReadPreconditionsDep) -> JobView:
    """Return a job's state, and its results once it has succeeded."""
    job = await wait.wait_for(lambda: services.ledger.status(job_id), lambda seen: seen.is_over)
    view = JobView.of(job, await run_in_threadpool(services.forecast, job))
    conditions.tag(resource_etag(job_id, job.revision, view))
    return view


@router.patch("/{job_id}", summary="Move a waiting job in the queue")
def change_job(
    services: ServicesDep,
    who: CurrentPrincipal,
    job_id: JOB_ID,
    wanted: PriorityChange,
    conditions: WritePreconditionsDep,
) -> JobView:
    """Change the priority of a queued job; with If-Match only if the job has not changed since."""
    services.ledger.get(job_id)
    job = services.queue.set_priority(job_id, wanted.priority, conditions.revision(job_id), who.name)
    view = JobView.of(job, services.forecast(job))
    conditions.tag(resource_etag(job_id, job.revision, view))
    return view


@router.put("/{job_id}/desired-state", summary="Cancel a job")
def set_job_desired_state(services: ServicesDep, who: CurrentPrincipal, job_id: JOB_ID, wanted: JobWish) -> JobView:
    """Cancel a queued or running job; repeating the request has no effect."""
    services.ledger.get(job_id)
    return JobView.of(services.cancel(job_id, who.name, wanted.reason))


@router.get("/{job_id}/attempts", summary="Every start of a job")
def read_job_attempts(services: ServicesDep, job_id: JOB_ID) -> AttemptsView:
    """Return the attempts of a job: worker, start, end and outcome of each."""
    attempts = services.ledger.status(job_id).attempts
    return AttemptsView(items=[AttemptView.model_validate(attempt) for attempt in attempts])


@router.get(
    "/{job_id}/log",
    summary="Log of a job",
    response_class=Response,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
)
def read_job_log(services: ServicesDep, job_id: JOB_ID) -> Response:
    """Return the log of all attempts of a job; empty before the first one."""
    services.ledger.get(job_id)
    try:
        return concatenated_log_response(_logs(services, job_id))
    except (NotFound, FileNotFoundError):  # a worker puts it away just now
        services.ledger.get(job_id)
        return concatenated_log_response(_logs(services, job_id))


@router.get(
    "/{job_id}/files/{name}",
    summary="A file that a job left",
    response_class=RangeFileResponse,
    openapi_extra=RANGED,
    responses={
        200: {"content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}},
    },
)
async def read_job_file(
    services: ServicesDep, job_id: JOB_ID, name: FILE_NAME, wait: Wait, conditions: ReadPreconditionsDep
) -> RangeFileResponse:
    """Download one of the files of a job, also in ranges."""
    view = await _view(services, job_id, wait)
    if not view.is_over:
        raise NotReady(f"job {job_id} is {view.state}; its files can be had when it has succeeded")
    if view.state is not ReconstructionState.SUCCEEDED or name not in view.files:
        raise NotFound(f"file of job {job_id}", name)
    kept = result_name(job_id, name)
    path = await run_in_threadpool(open_or_404, services.arrays, kept, f"file of job {job_id}", name)
    etag = etag_of_file(path)
    conditions.tag(etag)
    return RangeFileResponse(path, media_type="application/octet-stream", filename=name, headers={"ETag": etag})


def _logs(services: ServiceContainer, job_id: str) -> list[Path]:
    return [services.arrays.open(name) for name in services.arrays.list_names(result_name(job_id, LOG))]


async def _view(services: ServiceContainer, job_id: str, wait: Wait) -> JobView:
    return await wait.wait_for(lambda: JobView.of(services.ledger.status(job_id)), lambda view: view.is_over)
