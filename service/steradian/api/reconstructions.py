"""``/reconstructions``: jobs that turn a scan into a volume."""

from __future__ import annotations

from typing import Any, Literal, Self

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, Field, model_validator
from sqlalchemy.orm import Session
from starlette.concurrency import run_in_threadpool

from steradian.api.conditions import ConditionsNeeded, etag_of
from steradian.api.dependencies import Before, Limit, OptionalKey, ServicesNeeded, Wait, Who, link_next, replay
from steradian.api.identifiers import RECONSTRUCTION_ID
from steradian.api.requests import Wanted, check_request, note_request
from steradian.api.security import V1, GuardedRoute
from steradian.api.services import Services
from steradian.api.views import Listing, ReconstructionView
from steradian.errors import InvalidInput
from steradian.jobs.ledger import to_status
from steradian.jobs.model import DEFAULT_PRIORITY, LOWEST_PRIORITY, JobStatus
from steradian.jobs.requests import Identifier
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.storage.idempotency import Answer
from steradian.storage.tables import ReconstructionRow
from steradian.validation import Value, quantity

router = APIRouter(prefix=f"{V1}/reconstructions", tags=["reconstructions"], route_class=GuardedRoute)


_SCAN = "s01jz0000000000000000000000"


class Through(Value):
    """A mask through which a scan is looked at as if no other points had been measured."""

    mask_id: Identifier = Field(description="Identifier of the mask")
    points: Literal["nearest", "exact"] = Field(
        default="nearest", description="nearest: the measured point nearest to each of the mask's; exact: the same ones"
    )


class ReconstructionRequest(Value):
    """What to reconstruct and how."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {"scan_id": _SCAN, "parameters": {"modes": 226}},
                {"scan_id": _SCAN, "follow": True, "interval": 2},
                {"scan_id": _SCAN, "through": {"mask_id": "m0123456789abcdef01234567"}},
            ]
        }
    )

    scan_id: str = Field(min_length=1, max_length=64, description="Identifier of the scan")
    parameters: ReconstructionParameters = ReconstructionParameters()
    follow: bool = Field(
        default=False, description="Begin while the scan runs: a revision every few seconds, the whole at its end"
    )
    interval: float = quantity("s", "Between two revisions while following", ge=0.2, le=3600, default=2.0)
    through: Through | None = Field(default=None, description="Another mask, of a scan that is over")
    frame: int | None = Field(default=None, ge=0, description="Which frame of a scan that has several")
    priority: int = Field(default=DEFAULT_PRIORITY, ge=0, le=LOWEST_PRIORITY, description="Smaller ones run first")
    timeout: float | None = Field(default=None, gt=0, le=30 * 86_400, description="Longest it may run (s)")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.through is not None and (self.follow or self.frame is not None):
            raise InvalidInput("through", self.through.mask_id, "neither follow nor frame with it")
        if self.follow and self.frame is not None:
            raise InvalidInput("frame", self.frame, "none while following")
        return self

    @property
    def wanted(self) -> Wanted:
        """What is asked for, without when and who."""
        mask = {} if self.through is None else {"mask_id": self.through.mask_id, "points": self.through.points}
        return Wanted(self.parameters, self.follow, self.interval, frame=self.frame, **mask)  # type: ignore[arg-type]


class PriorityChange(Value):
    """What to change of a job that waits."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"priority": 10}]})

    priority: int = Field(ge=0, le=LOWEST_PRIORITY, description="Smaller ones run first")


class JobWish(Value):
    """What a job should become."""

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
    """Queue a reconstruction; with an Idempotency-Key a repeated request gets the first one's answer.

    With ``follow`` it begins while the scan runs; with ``through`` it shows what another mask would have seen.
    """

    def make(session: Session) -> Answer:
        row, job = note_request(
            services, session, scan, wanted.wanted, who, priority=wanted.priority, timeout=wanted.timeout
        )
        view = ReconstructionView.of(row, to_status(job))
        return Answer(202, view.links["self"], view.model_dump_json())

    scan = await run_in_threadpool(check_request, services, wanted.scan_id, wanted.wanted)
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
    row, job = await _look(services, reconstruction_id, wait)
    if not wait.seconds:
        conditions.tag(etag_of(reconstruction_id, job.revision))
    return ReconstructionView.of(row, job)


@router.patch("/{reconstruction_id}", summary="Move a waiting reconstruction in the queue")
def change_reconstruction(
    services: ServicesNeeded,
    reconstruction_id: RECONSTRUCTION_ID,
    wanted: PriorityChange,
    conditions: ConditionsNeeded,
) -> ReconstructionView:
    """Give a reconstruction that waits another priority; with If-Match only if it has not changed since."""
    row = services.reconstructions.get(reconstruction_id)
    job = services.queue.set_priority(row.id, wanted.priority, conditions.revision(row.id))
    conditions.tag(etag_of(row.id, job.revision))
    return ReconstructionView.of(row, job)


@router.put("/{reconstruction_id}/desired-state", summary="Cancel a reconstruction")
def wish(
    services: ServicesNeeded, who: Who, reconstruction_id: RECONSTRUCTION_ID, wanted: JobWish
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
    return ReconstructionView.of(*await _look(services, identifier, wait))


async def _look(services: Services, identifier: str, wait: Wait) -> tuple[ReconstructionRow, JobStatus]:
    def look() -> tuple[ReconstructionRow, JobStatus]:
        return services.reconstructions.get(identifier), services.ledger.status(identifier)

    return await wait.until(look, lambda seen: seen[1].is_over)


def is_over(view: ReconstructionView) -> bool:
    """Whether nothing of it will change any more."""
    return JobStatus(view.id, view.state).is_over
