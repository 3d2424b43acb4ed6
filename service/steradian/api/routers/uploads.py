"""``/uploads``: staged files for import, inspected only in a sandboxed process."""

from __future__ import annotations

import base64
import hashlib
import os
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, BinaryIO, Self, TypeAlias

from fastapi import APIRouter, Header, Request, Response
from pydantic import BaseModel, ConfigDict, Field, model_validator
from starlette.concurrency import run_in_threadpool

from steradian.api.http.array_response import JSON
from steradian.api.http.resumable_uploads import Part
from steradian.api.http.urls import link
from steradian.api.middleware.authentication import V1, AuthorizedRoute
from steradian.api.params.dependencies import ServicesDep
from steradian.api.params.path import UPLOAD_ID
from steradian.api.services import ServiceContainer
from steradian.core.exceptions import InvalidInput, NotFound
from steradian.core.validation import Value
from steradian.jobs.request_base import Identifier
from steradian.jobs.requests import check_described
from steradian.storage.blobs.interface import upload_name
from steradian.storage.db.timestamps_and_ids import new_id
from steradian.storage.repositories import deletion

router = APIRouter(prefix=f"{V1}/uploads", tags=["jobs"], route_class=AuthorizedRoute)
_BINARY = {
    "application/octet-stream": {"schema": {"type": "string", "format": "binary", "minLength": 1}, "examples": {}}
}


_PIECES = {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}, "examples": {}}}
TUS, TUS_VERSION = "Tus-Resumable", "1.0.0"
Length: TypeAlias = Annotated[
    int | None, Header(alias="Upload-Length", ge=1, description="Bytes of a file that is sent by PATCH", examples=[100])
]
Offset: TypeAlias = Annotated[
    int, Header(alias="Upload-Offset", ge=0, description="Received bytes; the body continues there", examples=[0])
]


class UploadPreviewRequest(Value):
    """Request to preview an import: description of the file, as in a job of kind ``import``."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"description": {"sampling_interval": 8e-9}}]})

    description: dict[str, Any] | None = Field(
        default=None, description="Values that are not in the file: sampling_interval, positions, sound_speed, …"
    )
    companion_id: Identifier | None = Field(
        default=None, description="Identifier of an upload with the positions (csv, npy) or of k-Wave's input file"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        check_described(self.description)
        return self


class MissingView(BaseModel):
    """Field that must be supplied before the file can be imported."""

    field: str = Field(description="Of the description")
    allowed: str


class UploadPreviewView(BaseModel):
    """Preview of an import: the interpretation of an uploaded file, and missing values."""

    model_config = ConfigDict(from_attributes=True)

    format: str
    points: int = Field(description="Sensors")
    frames: int
    samples: int = Field(description="Of an A-line")
    dtype: str = Field(description="Type of the samples as NumPy writes it")
    sampling_interval: float | None = Field(description="Seconds; null: not stated")
    time_zero: float = Field(description="From the pulse to the first sample (s)")
    sound_speed: float | None = Field(description="m/s; null: not stated")
    aperture: float | None = Field(description="Side of the square around the sensors (m); null: where is not stated")
    depth: float | None = Field(description="Distance of the point of interest (m); null: not stated")
    positions: list[list[float]] | None = Field(description="x, y of the sensors (m), a few thousand at most")
    rows: list[int] = Field(description="Which A-lines are shown")
    traces: list[list[float]] = Field(description="Their first samples; 0 for values that are not finite")
    missing: list[MissingView] = Field(description="Values that must be given before the file can be imported")
    notes: list[str] = Field(description="Decisions and assumptions where the file has no value")


class UploadView(BaseModel):
    """Upload: a complete or partial file to be imported."""

    id: str
    bytes: int = Field(description="That have come")
    length: int | None = Field(
        default=None, description="Size of the whole file, if the rest is still to be uploaded (bytes)"
    )
    sha256: str | None = Field(default=None, description="Checksum of the whole file, when the upload is complete")
    links: dict[str, str] = Field(examples=[{"self": "/api/v1/…"}])


@router.post(
    "",
    status_code=201,
    summary="Send a file to be imported",
    openapi_extra={"requestBody": {"required": True, "content": _BINARY}},
)
async def create_upload(
    services: ServicesDep, request: Request, response: Response, length: Length = None
) -> UploadView:
    """Store the body as a file: IPASC, k-Wave or MATLAB HDF5, npy, npz, CSV, .sgl, or a scan of this program.

    Then POST /jobs with kind ``import``. A file that nobody imports is deleted after a day. With Upload-Length the body
    is empty, and the bytes follow by PATCH; after an interruption, continue at the Upload-Offset of HEAD (tus 1.0).
    """
    identifier = new_id("u")
    here = link(f"/uploads/{identifier}")
    response.headers["Location"] = here
    draft = services.data.uploads / f"{identifier}.part"
    digest, size = hashlib.sha256(), 0
    if length is not None:
        await run_in_threadpool(_begin, services, identifier, length)
        response.headers.update(_progress(0, length))
        return UploadView(id=identifier, bytes=0, length=length, links={"self": here})

    def keep(file: BinaryIO, piece: bytes) -> None:
        _require_space(services, len(piece), size)
        digest.update(piece)
        file.write(piece)

    try:
        await run_in_threadpool(_require_space, services, int(request.headers.get("content-length", 0)))
        with await run_in_threadpool(draft.open, "wb") as file:
            async for piece in request.stream():
                await run_in_threadpool(keep, file, piece)
                size += len(piece)
            if not size:
                raise InvalidInput("body", "empty", "the bytes of a file")
            await run_in_threadpool(_fsync, file)
        await run_in_threadpool(services.arrays.put_and_commit, upload_name(identifier), draft)
    finally:
        await run_in_threadpool(draft.unlink, missing_ok=True)
    return UploadView(id=identifier, bytes=size, sha256=digest.hexdigest(), links={"self": here})


@router.get("/{upload_id}", summary="One upload")
def read_upload(services: ServicesDep, response: Response, upload_id: UPLOAD_ID) -> UploadView:
    """Return whether an upload exists, and its size; Upload-Offset is the number of received bytes."""
    about: dict[str, Any] = {"id": upload_id, "links": {"self": link(f"/uploads/{upload_id}")}}
    found = services.arrays.stat(upload_name(upload_id)) if _is_name(upload_id) else None
    if found is not None:
        response.headers.update(_progress(found.size, found.size))
        return UploadView(bytes=found.size, **about)
    part = Part.find(services.data.uploads, upload_id)
    come = part.offset
    response.headers.update(_progress(come, part.length))
    return UploadView(bytes=come, length=part.length, **about)


@router.patch(
    "/{upload_id}",
    status_code=204,
    summary="Send more of an upload",
    openapi_extra={"requestBody": {"required": True, "content": _PIECES}},
)
async def append_upload(services: ServicesDep, request: Request, upload_id: UPLOAD_ID, offset: Offset) -> Response:
    """Append the body to an upload created with Upload-Length; bytes received before an interruption are kept.

    The last byte completes the upload; Repr-Digest then has its SHA-256. An upload without data for a day is deleted.
    """
    part = await run_in_threadpool(Part.find, services.data.uploads, upload_id)
    size = offset

    def keep(file: BinaryIO, piece: bytes) -> None:
        if size + len(piece) > part.length:
            raise InvalidInput("body", f"more than {part.length - offset} bytes", f"the rest of {part.length} bytes")
        _require_space(services, len(piece), size)
        file.write(piece)
        file.flush()

    await run_in_threadpool(_require_space, services, int(request.headers.get("content-length", 0)), size)
    with part.open(offset) as file:
        async for piece in request.stream():
            await run_in_threadpool(keep, file, piece)
            size += len(piece)
        if size == part.length:
            digest = await run_in_threadpool(part.digest)
            await run_in_threadpool(services.arrays.put_and_commit, upload_name(upload_id), part.path)
            await run_in_threadpool(part.path.unlink, missing_ok=True)
            told = {"Repr-Digest": f"sha-256=:{base64.b64encode(digest).decode()}:"}
            return Response(status_code=204, headers=_progress(size, part.length) | told)
    return Response(status_code=204, headers=_progress(size, part.length))


@router.post("/{upload_id}/preview", summary="Preview of an upload's interpretation", response_model=UploadPreviewView)
async def preview_upload(services: ServicesDep, upload_id: UPLOAD_ID, wanted: UploadPreviewRequest) -> Response:
    """Inspect an upload in a sandboxed process as an import would, without importing it."""
    names = [upload_id, *([wanted.companion_id] if wanted.companion_id else [])]
    for name in names:
        if not _is_name(name) or await run_in_threadpool(services.arrays.stat, upload_name(name)) is None:
            raise NotFound("upload", name)
    paths = [await run_in_threadpool(services.arrays.open, upload_name(name)) for name in names]
    return Response(await services.process_pool.submit(_inspect, wanted.description, *paths), media_type=JSON)


@router.delete("/{upload_id}", status_code=204, summary="Forget an upload")
def delete_upload(services: ServicesDep, upload_id: UPLOAD_ID) -> Response:
    """Delete an upload; nothing happens if it does not exist. An upload that an import still needs is not deleted."""
    with suppress(NotFound):
        deletion.delete_upload(services.database, services.arrays, upload_id)
    with suppress(NotFound):
        Part.find(services.data.uploads, upload_id).path.unlink(missing_ok=True)
    return Response(status_code=204)


def _inspect(description: dict[str, Any] | None, *uploads: Path) -> bytes:
    from steradian.scans.importing.sandbox import inspect_in_sandbox
    from steradian.scans.importing.staging import stage_upload

    with tempfile.TemporaryDirectory(prefix="steradian-look-") as name:
        source, said = stage_upload(Path(name), description, *uploads)
        try:
            found = inspect_in_sandbox(source, Path(name), description=said)
        except InvalidInput as error:
            raise InvalidInput(f"description.{error.field}", error.value, error.allowed) from error
    return UploadPreviewView.model_validate(found, from_attributes=True).model_dump_json().encode()


def _require_space(services: ServiceContainer, count: int, received: int = 0) -> None:
    """Raise :class:`DiskFull` if ``count`` more bytes of an upload do not fit on the disk."""
    what = f"the upload, of which {received / 1e6:.1f} MB have come," if received else "the upload"
    services.disk.require(count, what)


def _begin(services: ServiceContainer, identifier: str, length: int) -> None:
    largest = services.settings.max_import_bytes
    if length > largest:
        raise InvalidInput("Upload-Length", length, f"1 to {largest} (bytes)")
    _require_space(services, length)
    Part.begin(services.data.uploads, identifier, length)


def _progress(come: int, length: int) -> dict[str, str]:
    return {"Upload-Offset": str(come), "Upload-Length": str(length), TUS: TUS_VERSION}


def _is_name(upload_id: str) -> bool:
    return upload_id.isascii() and upload_id.isalnum()


def _fsync(file: BinaryIO) -> None:
    """Flush received bytes to disk."""
    file.flush()
    os.fsync(file.fileno())
