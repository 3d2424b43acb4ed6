"""``/reconstructions``: jobs that turn a scan into a volume."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import FileResponse, StreamingResponse
from pydantic import ConfigDict, Field
from starlette.concurrency import run_in_threadpool

from steradian.api.dependencies import Before, Limit, ServicesNeeded, Wait, link_next
from steradian.api.npy import stream_npy
from steradian.api.problems import NotReady
from steradian.api.services import Services
from steradian.api.views import Listing, ReconstructionView
from steradian.errors import Conflict, InvalidInput, NotFound
from steradian.reconstructions.parameters import DEFAULT_SPACING, ReconstructionParameters
from steradian.storage.jobs import JobStatus
from steradian.storage.states import SETTLED_SCAN_STATES, ReconstructionState
from steradian.storage.tables import ReconstructionRow, ScanRow
from steradian.validation import Value

router = APIRouter(prefix="/reconstructions", tags=["reconstructions"])


class ReconstructionRequest(Value):
    """What to reconstruct and how."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"scan_id": "s01k…", "parameters": {"modes": 226}}]})

    scan_id: str = Field(min_length=1, max_length=64, description="Identifier of the scan")
    parameters: ReconstructionParameters = ReconstructionParameters()


class ReconstructionWish(Value):
    """What a reconstruction should become."""

    state: Literal["cancelled"]
    reason: str | None = Field(default=None, max_length=500)


@router.post(
    "",
    status_code=202,
    summary="Queue a reconstruction of a scan",
    responses={201: {"model": ReconstructionView, "description": "It was over within the time waited for"}},
)
async def create_reconstruction(
    services: ServicesNeeded, response: Response, wanted: ReconstructionRequest, wait: Wait
) -> ReconstructionView:
    """Queue a reconstruction."""

    def queue() -> ReconstructionRow:
        scan = services.scans.get(wanted.scan_id)
        _check(services, scan, wanted.parameters)
        services.require_queue()
        row = services.reconstructions.add(scan, wanted.parameters.model_dump(mode="json"))
        services.submit(row)
        return services.reconstructions.get(row.id)

    row = await run_in_threadpool(queue)
    view = await _view(services, row.id, wait)
    response.headers["Location"] = view.links["self"]
    response.status_code = 201 if _is_over(view) else 202
    return view


@router.get("", summary="Reconstructions, newest first")
def list_reconstructions(
    services: ServicesNeeded, request: Request, response: Response, limit: Limit = 100, before: Before = None
) -> Listing[ReconstructionView]:
    """List reconstructions."""
    page = services.reconstructions.page(limit, before)
    link_next(response, request, limit, page.cursor)
    return Listing(items=[ReconstructionView.of(row, services.status(row)) for row in page.rows])


@router.get("/{reconstruction_id}", summary="One reconstruction")
async def read_reconstruction(services: ServicesNeeded, reconstruction_id: str, wait: Wait) -> ReconstructionView:
    """Show a reconstruction."""
    return await _view(services, reconstruction_id, wait)


@router.put("/{reconstruction_id}/desired-state", summary="Cancel a reconstruction")
def wish(services: ServicesNeeded, reconstruction_id: str, wanted: ReconstructionWish) -> ReconstructionView:
    """Cancel a reconstruction that waits or runs; repeating it changes nothing."""
    row = services.reconstructions.get(reconstruction_id)
    job = services.queue.cancel(row.id) if row.submitted else services.status(row)
    row = services.reconstructions.want_cancelled(row.id, wanted.reason)
    return ReconstructionView.of(row, job)


@router.get(
    "/{reconstruction_id}/mip",
    summary="A maximum-intensity projection as PNG",
    response_class=FileResponse,
    responses={200: {"content": {"image/png": {}}}},
)
async def read_mip(
    services: ServicesNeeded, reconstruction_id: str, wait: Wait, axis: Annotated[Literal["x", "y", "z"], Query()] = "z"
) -> FileResponse:
    """Draw the projection along an axis, with scales in millimetres."""
    await _succeeded(services, reconstruction_id, wait)
    path = await _existing(services.data.job(reconstruction_id).mip(axis), f"MIP along {axis} of", reconstruction_id)
    return FileResponse(path, media_type="image/png")


@router.get(
    "/{reconstruction_id}/volume",
    summary="The volume as a NumPy file",
    response_class=StreamingResponse,
    responses={200: {"content": {"application/x-npy": {}}}},
)
async def read_volume(services: ServicesNeeded, reconstruction_id: str, wait: Wait) -> StreamingResponse:
    """Download the values, float32 [x, y, z], as npy."""
    await _succeeded(services, reconstruction_id, wait)
    path = await _existing(services.data.job(reconstruction_id).volume, "volume of", reconstruction_id)
    length, pieces = await run_in_threadpool(stream_npy, path)
    headers = {
        "Content-Length": str(length),
        "Content-Disposition": f'attachment; filename="{reconstruction_id}.npy"',
    }
    return StreamingResponse(pieces, media_type="application/x-npy", headers=headers)


@router.get(
    "/{reconstruction_id}/log",
    summary="What the job wrote while it ran",
    response_class=Response,
    responses={200: {"content": {"text/plain": {}}}},
)
def read_log(services: ServicesNeeded, reconstruction_id: str) -> Response:
    """Show the log of all attempts; empty before the first."""
    services.reconstructions.get(reconstruction_id)
    path = services.data.job(reconstruction_id).log
    text = path.read_bytes() if path.is_file() else b""
    return Response(text, media_type="text/plain; charset=utf-8")


async def _view(services: Services, identifier: str, wait: Wait) -> ReconstructionView:
    def look() -> ReconstructionView:
        row = services.reconstructions.get(identifier)
        return ReconstructionView.of(row, services.status(row))

    return await wait.until(look, _is_over)


async def _succeeded(services: Services, identifier: str, wait: Wait) -> None:
    """Refuse when the job has no result, with the reason."""
    view = await _view(services, identifier, wait)
    if view.state is ReconstructionState.SUCCEEDED:
        return
    if not _is_over(view):
        raise NotReady(f"reconstruction {identifier} is {view.state}; its result can be had when it has succeeded")
    why = f": {view.error.detail}" if view.error else ""
    raise Conflict(f"reconstruction {identifier} has {view.state} and left no result{why}")


async def _existing(path: Path, what: str, identifier: str) -> Path:
    if not await run_in_threadpool(path.is_file):
        raise NotFound(what, identifier)
    return path


def _is_over(view: ReconstructionView) -> bool:
    return JobStatus(view.id, view.state).is_over


def _check(services: Services, scan: ScanRow, parameters: ReconstructionParameters) -> None:
    """Refuse what cannot work before it is queued: a scan still running or empty, a volume too large."""
    if scan.state not in SETTLED_SCAN_STATES:
        raise NotReady(f"scan {scan.id} is {scan.state}; it can be reconstructed when it is over")
    if not services.data.scan_file(scan.id).is_file() or not (scan.summary or {}).get("stored", scan.done):
        raise Conflict(f"scan {scan.id} is {scan.state} and holds no A-lines")
    plan, mask = services.plans.get(scan.plan_id), services.masks.get(scan.mask_id)
    modes = parameters.modes or max(2, round(mask.aperture / DEFAULT_SPACING))
    size = 4 * (modes * parameters.upsampling) ** 2 * plan.parameters["samples"] * parameters.upsampling
    if size > services.settings.max_volume_bytes:
        raise InvalidInput(
            "parameters.modes", modes, f"a volume of at most {services.settings.max_volume_bytes} bytes, not {size}"
        )
