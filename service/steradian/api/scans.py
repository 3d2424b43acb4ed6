"""``/scans``: running plans on the scanner."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response
from fastapi.responses import FileResponse
from pydantic import Field
from starlette.concurrency import run_in_threadpool

from steradian.api.dependencies import (
    Before,
    BodyHash,
    IdempotencyKey,
    Limit,
    ServicesNeeded,
    Wait,
    link_next,
)
from steradian.api.problems import NotReady
from steradian.api.views import Listing, ScanView
from steradian.errors import NotFound
from steradian.storage.states import SETTLED_SCAN_STATES, DesiredScanState
from steradian.storage.tables import ScanRow
from steradian.validation import Value

router = APIRouter(prefix="/scans", tags=["scans"])


class ScanRequest(Value):
    """Which plan to run."""

    plan_id: str = Field(min_length=1, max_length=64, description="Identifier of the plan")


class ScanWish(Value):
    """What a scan should become."""

    state: DesiredScanState = Field(description="stopped keeps what was measured and is a success; aborted gives up")
    reason: str | None = Field(default=None, max_length=500)


@router.post("", status_code=201, summary="Queue a run of a plan")
async def create_scan(
    services: ServicesNeeded, response: Response, wanted: ScanRequest, key: IdempotencyKey, body: BodyHash, wait: Wait
) -> ScanView:
    """Queue a scan; with an Idempotency-Key a repeated request finds the scan that the first one made."""

    def queue() -> tuple[ScanRow, bool]:
        plan = services.plans.get(wanted.plan_id)
        return services.scans.queue(plan, simulated=services.settings.simulated, key=key, body_hash=body)

    row, is_new = await run_in_threadpool(queue)
    row = await wait.until(lambda: services.scans.get(row.id), _is_settled)
    view = ScanView.of(row)
    response.headers["Location"] = view.links["self"]
    if not is_new:
        response.headers["Idempotency-Replayed"] = "true"
    return view


@router.get("", summary="Scans, newest first")
def list_scans(
    services: ServicesNeeded, request: Request, response: Response, limit: Limit = 100, before: Before = None
) -> Listing[ScanView]:
    """List scans."""
    page = services.scans.page(limit, before)
    link_next(response, request, limit, page.cursor)
    return Listing(items=[ScanView.of(row) for row in page.rows])


@router.get("/{scan_id}", summary="One scan")
async def read_scan(services: ServicesNeeded, scan_id: str, wait: Wait) -> ScanView:
    """Show a scan."""
    return ScanView.of(await wait.until(lambda: services.scans.get(scan_id), _is_settled))


@router.put("/{scan_id}/desired-state", summary="Stop or abort a scan")
def wish(services: ServicesNeeded, scan_id: str, wanted: ScanWish) -> ScanView:
    """Say what a scan should become; repeating it changes nothing."""
    return ScanView.of(services.scans.desire(scan_id, wanted.state, wanted.reason))


@router.get(
    "/{scan_id}/file",
    summary="The A-lines as HDF5",
    response_class=FileResponse,
    responses={200: {"content": {"application/x-hdf5": {}}}, 206: {"description": "A range of it"}},
)
async def read_file(services: ServicesNeeded, scan_id: str, wait: Wait) -> FileResponse:
    """Download the scan file, also in ranges."""
    row = await wait.until(lambda: services.scans.get(scan_id), _is_settled)
    path = services.data.scan_file(scan_id)
    if not _is_settled(row):
        raise NotReady(f"scan {scan_id} is {row.state}; its file can be had when it is over")
    if not await run_in_threadpool(path.is_file):
        raise NotFound("file of scan", scan_id)
    return FileResponse(path, media_type="application/x-hdf5", filename=f"{scan_id}.h5")


def _is_settled(row: ScanRow) -> bool:
    return row.state in SETTLED_SCAN_STATES
