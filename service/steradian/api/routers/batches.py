"""``/batches``: sweeps of reconstructions of one scan over parameters, masks or wavelengths."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

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
from steradian.api.routers.reconstructions import JobWish
from steradian.api.schemas.batches import BatchRequest, BatchView
from steradian.api.schemas.resources import Listing
from steradian.api.services import ServiceContainer
from steradian.api.use_cases.submission import submit_batch
from steradian.core.exceptions import Conflict
from steradian.storage.db.tables import BatchRow
from steradian.storage.repositories import filters

router = APIRouter(prefix=f"{V1}/batches", tags=["batches"], route_class=AuthorizedRoute)


@router.post("", status_code=202, summary="Queue a sweep of parameters", response_model=BatchView)
def create_batch(
    services: ServicesDep, who: CurrentPrincipal, wanted: BatchRequest, key: OptionalIdempotencyKey
) -> Response:
    """Queue a reconstruction for every combination of values; all are queued or none is."""
    return idempotent_response(submit_batch(services, who, wanted, key))


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
    """Cancel all queued and running jobs of a batch; repeating the request has no effect."""
    row = services.batches.get(batch_id)
    for job in services.ledger.of_batch(batch_id):
        if not job.is_over:
            try:
                services.cancel(job.id, who.name, wanted.reason)
            except Conflict:
                continue  # it ended meanwhile
    return _view(services, row)


def _view(services: ServiceContainer, row: BatchRow) -> BatchView:
    return BatchView.of(row, services.ledger.of_batch(row.id))
