"""``/reconstructions/{id}/…``: what a reconstruction left behind."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool

from steradian.api.arrays import ARRAY_ANSWER, JSON, NPY, PICTURE, PNG, RAW, negotiate, respond
from steradian.api.conditions import ConditionsNeeded, etag_of_file
from steradian.api.dependencies import ServicesNeeded, Wait
from steradian.api.identifiers import RECONSTRUCTION_ID
from steradian.api.problems import NotReady
from steradian.api.reconstructions import is_over, view_of
from steradian.api.reports import ImageView
from steradian.api.security import V1, GuardedRoute
from steradian.api.services import Services
from steradian.errors import Conflict, NotFound
from steradian.jobs.kinds import LIVE
from steradian.storage.states import ReconstructionState

router = APIRouter(prefix=f"{V1}/reconstructions", tags=["reconstructions"], route_class=GuardedRoute)


class RevisionView(BaseModel):
    """An image of a scan that is being followed."""

    number: int
    points: int = Field(description="A-lines the image is made of")
    planned: int
    final: bool = Field(description="Whether it is the full reconstruction of the scan that is over")
    coverage: dict[str, float] = Field(
        description="Share of the points, and of the aperture's area, and the largest gap", examples=[{"points": 0.5}]
    )
    quality: dict[str, float | None] = Field(
        description="Correlation with the revision before, sharpness, maximum", examples=[{"sharpness": 0.1}]
    )
    image: ImageView = Field(description="Its shape and spacing")
    seconds: dict[str, float] = Field(description="What it cost", examples=[{"total": 0.2}])


Slice = Annotated[
    str | None,
    Query(max_length=100, description="x, y and z, numpy syntax; the axes of the answer", examples=["10:20,::2,5"]),
]


@router.get(
    "/{reconstruction_id}/mip",
    summary="A maximum-intensity projection as PNG",
    response_class=Response,
    responses={200: {"content": PICTURE}},
)
async def read_reconstruction_mip(
    services: ServicesNeeded,
    reconstruction_id: RECONSTRUCTION_ID,
    wait: Wait,
    conditions: ConditionsNeeded,
    axis: Annotated[
        Literal["x", "y", "z", "depth"], Query(description="Along which axis; depth: along z, coloured by depth")
    ] = "z",
) -> Response:
    """Show the projection along an axis, with scales in millimetres; the newest revision's while one is followed."""
    if not await run_in_threadpool(_is_followed, services, reconstruction_id):
        await _succeeded(services, reconstruction_id, wait)
    path = await _existing(services.data.job(reconstruction_id).mip(axis), f"MIP along {axis} of", reconstruction_id)

    def read() -> Response:
        with path.open("rb") as file:  # one version of it, though the next revision may replace it now
            etag = etag_of_file(path, file.fileno())
            conditions.tag(etag)
            return Response(file.read(), media_type=PNG, headers={"ETag": etag})

    return await run_in_threadpool(read)


@router.get(
    "/{reconstruction_id}/revision",
    summary="How good the newest revision is while a scan is followed",
)
async def read_reconstruction_revision(
    services: ServicesNeeded, response: Response, reconstruction_id: RECONSTRUCTION_ID, conditions: ConditionsNeeded
) -> RevisionView:
    """Show number, coverage and quality of the image that /mip shows; the last one is the full reconstruction."""
    await run_in_threadpool(services.reconstructions.get, reconstruction_id)
    path = services.data.job(reconstruction_id).revision
    if not await run_in_threadpool(path.is_file):
        job = await run_in_threadpool(services.ledger.status, reconstruction_id)
        if job.kind == LIVE and not job.is_over:
            raise NotReady(f"reconstruction {reconstruction_id} is {job.state} and has no revision yet", retry_after=2)
        raise NotFound("revision of", reconstruction_id)

    def read() -> RevisionView:
        with path.open("rb") as file:
            conditions.tag(etag_of_file(path, file.fileno()))
            return RevisionView.model_validate_json(file.read())

    return await run_in_threadpool(read)


@router.get(
    "/{reconstruction_id}/volume",
    summary="The volume, or a slice of it",
    response_class=Response,
    responses={200: ARRAY_ANSWER},
)
async def read_reconstruction_volume(
    services: ServicesNeeded,
    request: Request,
    reconstruction_id: RECONSTRUCTION_ID,
    wait: Wait,
    conditions: ConditionsNeeded,
    slice: Slice = None,
) -> Response:
    """Download the values, float32 [x, y, z], as npy, raw bytes (X-Shape, X-Dtype) or JSON."""
    kind = negotiate(request, (NPY, RAW, JSON))
    await _succeeded(services, reconstruction_id, wait)
    path = await _existing(services.data.job(reconstruction_id).volume, "volume of", reconstruction_id)
    etag = etag_of_file(path, kind=kind)
    conditions.tag(etag, vary="Accept")
    headers = {"ETag": etag, "X-Axes": "x,y,z", "Vary": "Accept"}
    if kind == NPY:
        headers["Content-Disposition"] = f'attachment; filename="{reconstruction_id}.npy"'
    limit = services.settings.max_volume_bytes
    return await run_in_threadpool(respond, path, "values", slice, kind, limit=limit, headers=headers)


@router.get(
    "/{reconstruction_id}/log",
    summary="What the job wrote while it ran",
    deprecated=True,
    response_class=Response,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
)
def read_reconstruction_log(services: ServicesNeeded, reconstruction_id: RECONSTRUCTION_ID) -> Response:
    """Show the same as GET /jobs/{id}/log, which is the address for every kind of job."""
    services.reconstructions.get(reconstruction_id)
    path = services.data.job(reconstruction_id).log
    text = path.read_bytes() if path.is_file() else b""
    return Response(text, media_type="text/plain; charset=utf-8")


async def _succeeded(services: Services, identifier: str, wait: Wait) -> None:
    """Refuse when the job has no result, with the reason."""
    view = await view_of(services, identifier, wait)
    if view.state is ReconstructionState.SUCCEEDED:
        return
    if not is_over(view):
        raise NotReady(f"reconstruction {identifier} is {view.state}; its result can be had when it has succeeded")
    why = f": {view.error.detail}" if view.error else ""
    raise Conflict(f"reconstruction {identifier} has {view.state} and left no result{why}")


def _is_followed(services: Services, identifier: str) -> bool:
    """Whether there are pictures of a job that is not over."""
    job = services.ledger.status(identifier)
    return job.kind == LIVE and not job.is_over and services.data.job(identifier).revision.is_file()


async def _existing(path: Path, what: str, identifier: str) -> Path:
    if not await run_in_threadpool(path.is_file):
        raise NotFound(what, identifier)
    return path
