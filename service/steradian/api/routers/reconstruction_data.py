"""``/reconstructions/{id}/…``: projections, volume slices, Zarr hierarchy and revisions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response
from fastapi import Path as Path_
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool

from steradian.api.background.peers import ForwardToPeer
from steradian.api.errors.handlers import NotReady
from steradian.api.http.array_response import JSON, NPY, PICTURE, PNG, RAW, negotiate
from steradian.api.http.conditional import ReadPreconditionsDep, etag_of_file
from steradian.api.http.file_response import open_or_404
from steradian.api.http.volume_params import VOXELS, DataType, Index, Level, MaxSize, Part, Slab, WindowText
from steradian.api.http.volume_response import ProjectionQuery, VolumeQuery, projection_response, volume_response
from steradian.api.middleware.authentication import V1, AuthorizedRoute
from steradian.api.params.dependencies import ServicesDep, Wait
from steradian.api.params.path import RECONSTRUCTION_ID
from steradian.api.routers.reconstructions import read_with_wait
from steradian.api.schemas.reports import ImageView
from steradian.api.services import ServiceContainer
from steradian.core.exceptions import Conflict, InvalidInput, NotFound
from steradian.jobs.job import JobStatus
from steradian.jobs.registry import LIVE_KIND
from steradian.reconstructions.volumes.reader import stored_volume
from steradian.reconstructions.volumes.zarr_view import get_node
from steradian.storage.blobs.interface import result_name
from steradian.storage.data_dir.job_directory import REVISION, SERIES, VOLUME
from steradian.storage.state_machines import ReconstructionState

router = APIRouter(prefix=f"{V1}/reconstructions", tags=["reconstructions"], route_class=AuthorizedRoute)


class RevisionView(BaseModel):
    """Revision of a live reconstruction: one image of a growing scan."""

    number: int
    points: int = Field(description="A-lines the image is made of")
    planned: int
    final: bool = Field(description="Whether it is the full reconstruction of the completed scan")
    coverage: dict[str, float] = Field(
        description="Share of the points, and of the aperture's area, and the largest gap", examples=[{"points": 0.5}]
    )
    quality: dict[str, float | None] = Field(
        description="Correlation with the revision before, sharpness, maximum", examples=[{"sharpness": 0.1}]
    )
    image: ImageView = Field(description="Its shape and spacing")
    seconds: dict[str, float] = Field(description="What it cost", examples=[{"total": 0.2}])


@router.get(
    "/{reconstruction_id}/mip",
    summary="A maximum-intensity projection as PNG or numbers",
    response_class=Response,
    responses={200: {**VOXELS, "content": PICTURE | VOXELS["content"]}},
)
async def read_reconstruction_mip(
    services: ServicesDep,
    request: Request,
    reconstruction_id: RECONSTRUCTION_ID,
    wait: Wait,
    conditions: ReadPreconditionsDep,
    axis: Annotated[
        Literal["x", "y", "z", "depth"],
        Query(description="Along which axis; depth: along z, coloured by depth, or as numbers the depth in metres"),
    ] = "z",
    slab: Slab = None,
    max_size: MaxSize = None,
    dtype: DataType = None,
    window: WindowText = None,
    index: Index = None,
) -> Response:
    """Return a maximum-intensity projection; of the newest revision while the reconstruction is live.

    The PNG picture has scales in millimetres; that of a series shows all its volumes, along z only.
    Numbers cover all depths, but along z of a live reconstruction only those
    below the near field, as its picture does. Each number is the maximum of the voxels that it covers.
    """
    kind = negotiate(request, (PNG, NPY, RAW, JSON))
    if not await run_in_threadpool(is_live, services, reconstruction_id):
        await require_succeeded(services, reconstruction_id, wait)
    if kind != PNG:
        wish = ProjectionQuery(axis, slab, max_size, dtype, window, index)
        return await run_in_threadpool(projection_response, services.arrays, reconstruction_id, kind, conditions, wish)
    only_numbers = {"slab": slab, "max_size": max_size, "dtype": dtype, "window": window, "index": index}
    for name, given in only_numbers.items():
        if given is not None:
            raise InvalidInput(name, given, f"nothing for a picture; numbers come with Accept: {RAW}, {NPY} or {JSON}")

    def read() -> Response:
        name = result_name(reconstruction_id, f"mip-{axis}.png")
        path = open_or_404(services.arrays, name, f"MIP along {axis} of", reconstruction_id)
        with path.open("rb") as file:  # one version of it, though the next revision may replace it now
            etag = etag_of_file(path, file.fileno())
            conditions.tag(etag, vary="Accept")
            return Response(file.read(), media_type=PNG, headers={"ETag": etag, "Vary": "Accept"})

    return await run_in_threadpool(read)


@router.get(
    "/{reconstruction_id}/revision",
    summary="How good the newest revision is while a scan is followed",
)
async def read_reconstruction_revision(
    services: ServicesDep, response: Response, reconstruction_id: RECONSTRUCTION_ID, conditions: ReadPreconditionsDep
) -> RevisionView:
    """Return number, coverage and quality of the revision that /mip shows; the last one is the full reconstruction."""
    await run_in_threadpool(services.ledger.reconstruction, reconstruction_id)
    name = result_name(reconstruction_id, REVISION)
    if not await run_in_threadpool(services.arrays.stat, name):
        job = await run_in_threadpool(services.ledger.status, reconstruction_id)
        if job.kind == LIVE_KIND and not job.is_over:
            await run_in_threadpool(forward_if_remote, services, job)
            raise NotReady(f"reconstruction {reconstruction_id} is {job.state} and has no revision yet", retry_after=2)
        raise NotFound("revision of", reconstruction_id)

    def read() -> RevisionView:
        path = open_or_404(services.arrays, name, "revision of", reconstruction_id)
        with path.open("rb") as file:
            conditions.tag(etag_of_file(path, file.fileno()))
            return RevisionView.model_validate_json(file.read())

    return await run_in_threadpool(read)


@router.get(
    "/{reconstruction_id}/volume",
    summary="The volume, or a slice of it, at full resolution or coarser",
    response_class=Response,
    responses={200: VOXELS},
)
async def read_reconstruction_volume(
    services: ServicesDep,
    request: Request,
    reconstruction_id: RECONSTRUCTION_ID,
    wait: Wait,
    conditions: ReadPreconditionsDep,
    slice: Part = None,
    level: Level = None,
    max_size: MaxSize = None,
    dtype: DataType = None,
    window: WindowText = None,
    index: Index = None,
) -> Response:
    """Download the values, float32 [x, y, z], as npy, raw bytes or JSON; headers contain shape, type and axes."""
    kind = negotiate(request, (NPY, RAW, JSON))
    await require_succeeded(services, reconstruction_id, wait)
    limit = services.settings.max_volume_bytes

    def read() -> Response:
        wish = VolumeQuery(slice, level, max_size, dtype, window, index)
        return volume_response(services.arrays, reconstruction_id, kind, conditions, wish, limit)

    return await run_in_threadpool(read)


@router.get(
    "/{reconstruction_id}/volume.ome.zarr/{path:path}",
    summary="The volume as OME-Zarr, for programs that open one by its address",
    response_class=Response,
    responses={200: {"content": {RAW: {"schema": {"type": "string", "format": "binary"}}}}},
)
async def read_reconstruction_zarr(
    services: ServicesDep,
    reconstruction_id: RECONSTRUCTION_ID,
    path: Annotated[
        str, Path_(max_length=60, description="Member of the hierarchy: metadata or a chunk", examples=["0/c/0/0/0"])
    ],
    wait: Wait,
    conditions: ReadPreconditionsDep,
) -> Response:
    """Return zarr.json of the group, LEVEL/zarr.json, or a chunk LEVEL/c/Z/Y/X (version 0.5; axes z, y, x; float32).

    Of a series INDEX comes before: volume.ome.zarr/2 is the address of the third volume.
    """
    await require_succeeded(services, reconstruction_id, wait)

    def read() -> Response:
        file, index, node = _stored_node(services, reconstruction_id, path)
        etag = etag_of_file(file)
        conditions.tag(etag)
        found = get_node(stored_volume(file, etag, index), node)
        if found is None:
            raise NotFound(f"member of the hierarchy of {reconstruction_id}", path)
        return Response(found, media_type=RAW, headers={"ETag": etag})

    return await run_in_threadpool(read)


def _stored_node(services: ServiceContainer, identifier: str, path: str) -> tuple[Path, int | None, str]:
    """Return the file of a volume, its index in a series, and the path of a node in its hierarchy."""
    if services.arrays.stat(result_name(identifier, SERIES)) is None:
        return open_or_404(services.arrays, result_name(identifier, VOLUME), "volume of", identifier), None, path
    index, _, node = path.partition("/")
    if not (index.isascii() and index.isdecimal() and len(index) < 10):
        raise NotFound(f"member of the hierarchy of {identifier}", path)
    return open_or_404(services.arrays, result_name(identifier, SERIES), "series of", identifier), int(index), node


async def require_succeeded(services: ServiceContainer, identifier: str, wait: Wait) -> None:
    """Raise :class:`NotReady` or :class:`Conflict` unless a reconstruction has succeeded."""
    job = await read_with_wait(services, identifier, wait)
    if job.state is ReconstructionState.SUCCEEDED:
        return
    if not job.is_over:
        raise NotReady(f"reconstruction {identifier} is {job.state}; its result can be had when it has succeeded")
    why = f": {job.error or ''}" if job.error_code else ""
    raise Conflict(f"reconstruction {identifier} has {job.state} and left no result{why}")


def is_live(services: ServiceContainer, identifier: str) -> bool:
    """Return whether a live reconstruction is still running or queued and has a revision."""
    job = services.ledger.status(identifier)
    if job.kind != LIVE_KIND or job.is_over:
        return False
    if services.arrays.stat(result_name(identifier, REVISION)) is not None:
        return True
    forward_if_remote(services, job)
    return False


def forward_if_remote(services: ServiceContainer, job: JobStatus) -> None:
    """Raise :class:`ForwardToPeer` if another node executes a live reconstruction."""
    scanner_id = services.scans.get(job.payload["scan_id"]).scanner_id
    if scanner_id is not None and services.nodes.follows(scanner_id):
        raise ForwardToPeer(scanner_id)
