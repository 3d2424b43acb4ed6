"""``/batches``.

Queue many reconstructions of one scan in one request (sweeps over parameters, masks or wavelengths).
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from datetime import datetime
from typing import Any, Literal, Self

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy.orm import Session
from starlette.concurrency import run_in_threadpool

from steradian.api.http.urls import link
from steradian.api.middleware.authentication import V1, AuthorizedRoute
from steradian.api.params.dependencies import (
    CurrentPrincipal,
    Limit,
    OptionalIdempotencyKey,
    PageCursor,
    ServicesDep,
    idempotent_response,
    set_next_link,
)
from steradian.api.params.filters import BatchStates, ScanIdFilter
from steradian.api.params.path import BATCH_ID
from steradian.api.routers.reconstructions import JobWish, create_rows
from steradian.api.schemas.reports import ReportView
from steradian.api.schemas.resources import Listing
from steradian.api.services import ServiceContainer
from steradian.api.use_cases.admission import check_reconstruction, check_references, estimate_resources, frames_of
from steradian.core.exceptions import Conflict, InvalidInput
from steradian.core.validation import Value
from steradian.jobs.model import DEFAULT_PRIORITY, LOWEST_PRIORITY, JobStatus
from steradian.jobs.queue.ledger import to_status
from steradian.jobs.requests import Identifier, ReconstructionRequest, Required, Through
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.storage.db.tables import BatchRow, ReconstructionRow
from steradian.storage.repositories import filters
from steradian.storage.repositories.idempotency import StoredResponse
from steradian.storage.repositories.references import lock_references
from steradian.storage.states import BatchState, is_terminal

router = APIRouter(prefix=f"{V1}/batches", tags=["batches"], route_class=AuthorizedRoute)
MAX_JOBS = 200
_SCAN = "s01jz0000000000000000000000"
_EXAMPLES: list[Any] = [
    {"scan_id": _SCAN, "vary": {"sound_speed": [1480, 1490, 1500]}, "parameters": {"modes": 226}},
    {"scan_id": _SCAN, "vary": {"mask_id": ["m0123456789abcdef01234567", "m1123456789abcdef01234567"]}},
    {"scan_id": _SCAN, "each": "wavelength"},
]


class BatchRequest(Value):
    """Request of a batch: one job for every combination of the varied values."""

    model_config = ConfigDict(json_schema_extra={"examples": _EXAMPLES})

    scan_id: Identifier = Field(description="Identifier of the scan")
    vary: dict[str, list[Any]] = Field(
        default_factory=dict,
        description="Values of each swept parameter; mask_id: subset masks (what-if), frame: frames",
    )
    each: Literal["wavelength", "frame"] | None = Field(
        default=None, description="A job for each excitation wavelength of the scan (its first frame), or each frame"
    )
    parameters: dict[str, Any] = Field(default_factory=dict, description="Parameters common to all jobs")
    points: Literal["nearest", "exact"] = Field(default="nearest", description="Options for subset masks")
    priority: int = Field(default=DEFAULT_PRIORITY, ge=0, le=LOWEST_PRIORITY, description="Smaller ones run first")
    requires: Required = Field(default=Required(), description="Capabilities required of each job's worker")

    def expand_grid(self, excitation: list[float]) -> dict[str, list[Any]]:
        """Return the varied values with the shorthand "each" expanded.

        ``excitation`` is the wavelength of each frame.
        """
        if self.each is None:
            return self.vary
        first: dict[float, int] = {}
        for number, wavelength in enumerate(excitation):
            first.setdefault(wavelength, number)
        return self.vary | {"frame": list(range(len(excitation))) if self.each == "frame" else list(first.values())}

    def to_job_requests(self, vary: dict[str, list[Any]]) -> list[ReconstructionRequest]:
        """Return one job request per combination of values.

        Raises :class:`InvalidInput` for too many or an invalid one.
        """
        count, known = 1, [*ReconstructionParameters.model_fields, *_BESIDE]
        for name, values in vary.items():
            if name not in known:
                raise InvalidInput("vary", name, ", ".join(known))
            count *= len(values)
        if not vary or not 1 <= count <= MAX_JOBS:
            raise InvalidInput("vary", f"{count} jobs" if vary else "empty", f"1 to {MAX_JOBS} jobs")
        if "mask_id" in vary and "frame" in vary:
            raise InvalidInput("vary", "mask_id and frame", "one of the two")
        return [self._one(dict(zip(vary, values, strict=True))) for values in itertools.product(*vary.values())]

    def _one(self, chosen: dict[str, Any]) -> ReconstructionRequest:
        beside = SweepOptions.create(**{name: chosen.pop(name) for name in _BESIDE if name in chosen})
        parameters = ReconstructionParameters.create(**self.parameters | chosen)
        through = None if beside.mask_id is None else Through(mask_id=beside.mask_id, points=self.points)
        about: dict[str, Any] = {"through": through, "frame": beside.frame}
        about |= {"priority": self.priority, "requires": self.requires}
        return ReconstructionRequest.create(scan_id=self.scan_id, parameters=parameters, **about)


class SweepOptions(Value):
    """Request fields that may vary besides reconstruction parameters."""

    mask_id: Identifier | None = None
    frame: int | None = Field(default=None, ge=0)


_BESIDE = tuple(SweepOptions.model_fields)


class MemberView(BaseModel):
    """Job of a batch, as shown in the response."""

    id: str
    varied: dict[str, Any]
    state: str
    progress: float = Field(description="0 to 1 within the present stage")
    figures: ReportView | None = Field(description="Its report, when it has succeeded")


class BatchView(BaseModel):
    """A batch and how its jobs stand."""

    id: str
    scan_id: str
    vary: dict[str, Any]
    parameters: dict[str, Any]
    state: BatchState = Field(
        description="succeeded when all jobs have; failed or cancelled when all are over and one is; of jobs that are"
        " not kept any more nothing is known, and a batch of nothing else is forgotten"
    )
    counts: dict[str, int] = Field(description="Jobs in each state", examples=[{"queued": 2, "succeeded": 1}])
    jobs: list[MemberView]
    created: datetime
    links: dict[str, str]

    @classmethod
    def of(cls, row: BatchRow, members: list[ReconstructionRow], jobs: dict[str, JobStatus]) -> Self:
        """Show a row with its jobs."""
        counts = Counter(str(jobs[member.id].state) for member in members)
        if forgotten := math.prod(len(values) for values in row.vary.values()) - len(members):
            counts["forgotten"] = forgotten
        here = link(f"/batches/{row.id}")
        return cls(
            id=row.id,
            scan_id=row.scan_id,
            vary=row.vary,
            parameters=row.parameters,
            state=BatchState.of(counts),
            counts=dict(counts),
            jobs=[_member(row, member, jobs[member.id]) for member in members],
            created=row.created,
            links={"self": here, "scan": link(f"/scans/{row.scan_id}")},
        )


@router.post("", status_code=202, summary="Queue a sweep of parameters", response_model=BatchView)
async def create_batch(
    services: ServicesDep, who: CurrentPrincipal, wanted: BatchRequest, key: OptionalIdempotencyKey
) -> Response:
    """Queue a reconstruction for every combination of values; all are queued or none is."""

    def make(session: Session) -> StoredResponse:
        services.require_disk_space(
            session, sum(cost.disk for cost in costs), f"the batch of {len(costs)} volumes", measured
        )
        lock_references(session, *(one.model_dump(mode="json") for one in chosen))
        batch = services.batches.add(session, scan, vary, wanted.parameters, who.name)
        noted = [
            create_rows(services, session, scan, one, who, cost, batch) for one, cost in zip(chosen, costs, strict=True)
        ]
        members = [row for row, _ in noted]
        view = BatchView.of(batch, members, {row.id: to_status(job) for row, job in noted})
        return StoredResponse(202, view.links["self"], view.model_dump_json())

    answer = await run_in_threadpool(services.answers.get, key)
    if answer is None:
        excitation = await run_in_threadpool(_excitation, services, wanted.scan_id)
        vary = wanted.expand_grid(excitation)
        chosen = wanted.to_job_requests(vary)
        scan = await run_in_threadpool(check_reconstruction, services, chosen[0])
        for one in chosen:
            await run_in_threadpool(check_references, services, scan, one)
        costs = await run_in_threadpool(lambda: [estimate_resources(services, scan, one) for one in chosen])
        measured = await run_in_threadpool(services.refresh_disk_usage)
        answer = await run_in_threadpool(services.answers.run_once, key, make)
    return idempotent_response(answer)


@router.get("", summary="Batches, newest first")
def list_batches(
    services: ServicesDep,
    request: Request,
    response: Response,
    state: BatchStates = None,
    scan_id: ScanIdFilter = None,
    limit: Limit = 20,
    before: PageCursor = None,
) -> Listing[BatchView]:
    """List batches."""
    page = services.batches.page(limit, before, filters.batches(state=state, scan_id=scan_id))
    set_next_link(response, request, limit, page.cursor)
    return Listing(items=[_view(services, row) for row in page.rows])


@router.get("/{batch_id}", summary="One batch and its jobs")
def read_batch(services: ServicesDep, batch_id: BATCH_ID) -> BatchView:
    """Return the states of a batch's jobs and the results of the finished ones."""
    return _view(services, services.batches.get(batch_id))


@router.put("/{batch_id}/desired-state", summary="Cancel a batch's remaining jobs")
def set_batch_desired_state(
    services: ServicesDep, who: CurrentPrincipal, batch_id: BATCH_ID, wanted: JobWish
) -> BatchView:
    """Cancel every job that waits or runs; repeating it changes nothing."""
    row = services.batches.get(batch_id)
    for member in services.reconstructions.of_batch(batch_id):
        if not is_terminal(services.ledger.get(member.id).state):
            try:
                services.cancel(member.id, who.name, wanted.reason)
            except Conflict:
                continue  # it ended meanwhile
    return _view(services, row)


def _excitation(services: ServiceContainer, scan_id: str) -> list[float]:
    return frames_of(services.plans.get(services.scans.get(scan_id).plan_id).parameters)


def _view(services: ServiceContainer, row: BatchRow) -> BatchView:
    members = services.reconstructions.of_batch(row.id)
    jobs = services.ledger.statuses([member.id for member in members])
    return BatchView.of(row, [member for member in members if member.id in jobs], jobs)


def _member(batch: BatchRow, row: ReconstructionRow, job: JobStatus) -> MemberView:
    asked = {**row.parameters, **job.payload, **(job.payload.get("through") or {})}
    varied = {name: asked.get(name) for name in batch.vary}
    progress = 1.0 if job.is_over else job.done / job.total if job.total else 0.0
    result = ReportView.model_validate(job.result) if job.result else None
    return MemberView(id=row.id, varied=varied, state=job.state, progress=progress, figures=result)
