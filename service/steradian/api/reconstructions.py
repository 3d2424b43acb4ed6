"""``/reconstructions``: jobs that turn a scan into a volume."""

from __future__ import annotations

from typing import Any, Literal

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy.orm import Session
from starlette.concurrency import run_in_threadpool

from steradian.api.conditions import ConditionsNeeded, etag_of
from steradian.api.dependencies import Before, Limit, OptionalKey, ServicesNeeded, Wait, Who, link_next, replay
from steradian.api.documents import RECONSTRUCTION_ID
from steradian.api.requests import check_request, note_request
from steradian.api.security import V1, GuardedRoute
from steradian.api.services import Services
from steradian.api.views import Listing, ReconstructionView
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.storage.idempotency import Answer
from steradian.storage.job_ledger import to_status
from steradian.storage.jobs import DEFAULT_PRIORITY, LOWEST_PRIORITY, JobStatus
from steradian.validation import Value

router = APIRouter(prefix=f"{V1}/reconstructions", tags=["reconstructions"], route_class=GuardedRoute)


class ReconstructionRequest(Value):
    """What to reconstruct and how."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"scan_id": "s01jz0000000000000000000000", "parameters": {"modes": 226}}]}
    )

    scan_id: str = Field(min_length=1, max_length=64, description="Identifier of the scan")
    parameters: ReconstructionParameters = ReconstructionParameters()
    priority: int = Field(default=DEFAULT_PRIORITY, ge=0, le=LOWEST_PRIORITY, description="Smaller ones run first")
    timeout: float | None = Field(default=None, gt=0, le=30 * 86_400, description="Longest it may run (s)")


class ReconstructionChange(Value):
    """What to change of a reconstruction."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"priority": 10}]})

    priority: int = Field(ge=0, le=LOWEST_PRIORITY, description="Smaller ones run first")


class ReconstructionWish(Value):
    """What a reconstruction should become."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"state": "cancelled", "reason": "typo"}]})

    state: Literal["cancelled"]
    reason: str | None = Field(default=None, max_length=500)


class AttemptsView(BaseModel):
    """Every start of a job with its end."""

    items: list[dict[str, Any]] = Field(
        description="number, worker, started, ended, outcome, detail",
        examples=[[{"number": 1, "worker": "worker-0", "outcome": "died", "detail": "killed by signal SIGKILL"}]],
    )


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
    """Queue a reconstruction; with an Idempotency-Key a repeated request gets the first one's answer."""

    def make(session: Session) -> Answer:
        row, job = note_request(
            services, session, scan, wanted.parameters, who, priority=wanted.priority, timeout=wanted.timeout
        )
        view = ReconstructionView.of(row, to_status(job))
        return Answer(202, view.links["self"], view.model_dump_json())

    scan = await run_in_threadpool(check_request, services, wanted.scan_id, wanted.parameters)
    answer = await run_in_threadpool(services.answers.once, key, make)
    identifier = answer.location.rpartition("/")[2]
    await run_in_threadpool(services.enqueue, identifier)
    if not wait.seconds or answer.replayed:
        return replay(answer)
    view = await view_of(services, identifier, wait)
    status = 201 if is_over(view) else 202
    response = replay(Answer(status, answer.location, view.model_dump_json()))
    response.headers["Preference-Applied"] = f"wait={wait.seconds:g}"
    return response


@router.get("", summary="Reconstructions, newest first")
def list_reconstructions(
    services: ServicesNeeded, request: Request, response: Response, limit: Limit = 100, before: Before = None
) -> Listing[ReconstructionView]:
    """List reconstructions."""
    page = services.reconstructions.page(limit, before)
    link_next(response, request, limit, page.cursor)
    jobs = services.ledger.statuses([row.id for row in page.rows])
    return Listing(items=[ReconstructionView.of(row, jobs[row.id]) for row in page.rows if row.id in jobs])


@router.get("/{reconstruction_id}", summary="One reconstruction")
async def read_reconstruction(
    services: ServicesNeeded, reconstruction_id: RECONSTRUCTION_ID, wait: Wait, conditions: ConditionsNeeded
) -> ReconstructionView:
    """Show a reconstruction."""
    if not wait.seconds:
        conditions.tag(etag_of(reconstruction_id, await run_in_threadpool(_revision, services, reconstruction_id)))
    return await view_of(services, reconstruction_id, wait)


@router.patch("/{reconstruction_id}", summary="Move a waiting reconstruction in the queue")
def change_reconstruction(
    services: ServicesNeeded, reconstruction_id: RECONSTRUCTION_ID, wanted: ReconstructionChange
) -> ReconstructionView:
    """Give a reconstruction that waits another priority."""
    row = services.reconstructions.get(reconstruction_id)
    return ReconstructionView.of(row, services.queue.set_priority(row.id, wanted.priority))


@router.put("/{reconstruction_id}/desired-state", summary="Cancel a reconstruction")
def wish(
    services: ServicesNeeded, who: Who, reconstruction_id: RECONSTRUCTION_ID, wanted: ReconstructionWish
) -> ReconstructionView:
    """Cancel a reconstruction that waits or runs; repeating it changes nothing."""
    row = services.reconstructions.get(reconstruction_id)
    return ReconstructionView.of(row, services.cancel(row.id, who.name, wanted.reason))


@router.get("/{reconstruction_id}/attempts", summary="Every start of the job")
def read_attempts(services: ServicesNeeded, reconstruction_id: RECONSTRUCTION_ID) -> AttemptsView:
    """Show which worker started the job when, and how each start ended."""
    services.reconstructions.get(reconstruction_id)
    return AttemptsView(items=services.ledger.status(reconstruction_id).attempts)


async def view_of(services: Services, identifier: str, wait: Wait) -> ReconstructionView:
    """Show a reconstruction, held until it is over where the client waits."""

    def look() -> ReconstructionView:
        return ReconstructionView.of(services.reconstructions.get(identifier), services.ledger.status(identifier))

    return await wait.until(look, is_over)


def _revision(services: Services, identifier: str) -> int:
    services.reconstructions.get(identifier)
    return services.ledger.get(identifier).revision


def is_over(view: ReconstructionView) -> bool:
    """Whether nothing of it will change any more."""
    return JobStatus(view.id, view.state).is_over
