"""``/uploads``: files that become scans. They are kept as they come; only an import's own process looks into them."""

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool

from steradian.api.dependencies import ServicesNeeded
from steradian.api.identifiers import UPLOAD_ID
from steradian.api.security import V1, GuardedRoute
from steradian.api.services import Services
from steradian.api.views import BASE
from steradian.drafts import sync_folder
from steradian.errors import InvalidInput, NotFound
from steradian.storage import deletion
from steradian.storage.disk import promised
from steradian.storage.repository import new_id

router = APIRouter(prefix=f"{V1}/uploads", tags=["jobs"], route_class=GuardedRoute)
_BINARY = {
    "application/octet-stream": {"schema": {"type": "string", "format": "binary", "minLength": 1}, "examples": {}}
}


class UploadView(BaseModel):
    """A file that waits to be imported."""

    id: str
    bytes: int
    sha256: str | None = Field(default=None, description="Of the whole file, when it has just come")
    links: dict[str, str] = Field(examples=[{"self": "/api/v1/…"}])


@router.post(
    "",
    status_code=201,
    summary="Send a file to be imported",
    openapi_extra={"requestBody": {"required": True, "content": _BINARY}},
)
async def create_upload(services: ServicesNeeded, request: Request, response: Response) -> UploadView:
    """Keep the body as a file: IPASC, k-Wave or MATLAB HDF5, npy, npz, CSV, or a scan of this program.

    Then POST /jobs with kind ``import``. A file that nobody imports is deleted after a day.
    """
    identifier = new_id("u")
    path = services.data.upload(identifier)
    draft = path.with_name(f"{identifier}.part")
    digest, size = hashlib.sha256(), 0
    measured, taken = await run_in_threadpool(lambda: (services.measure(), _promised(services)))

    def require(count: int) -> None:
        what = f"the upload, of which {size / 1e6:.1f} MB have come," if size else "the upload"
        used = measured.used + services.arrivals.came - measured.came
        services.disk.require(count, what, taken + services.arrivals.awaited, used)

    def keep(file: BinaryIO, piece: bytes) -> None:
        take(len(piece))
        digest.update(piece)
        file.write(piece)

    try:
        with services.arrivals.upload(int(request.headers.get("content-length", 0)), require) as take:
            with await run_in_threadpool(draft.open, "wb") as file:
                async for piece in request.stream():
                    await run_in_threadpool(keep, file, piece)
                    size += len(piece)
                if not size:
                    raise InvalidInput("body", "empty", "the bytes of a file")
                await run_in_threadpool(_finish, file, draft, path)
    finally:
        await run_in_threadpool(draft.unlink, missing_ok=True)
    here = f"{BASE}/uploads/{identifier}"
    response.headers["Location"] = here
    return UploadView(id=identifier, bytes=size, sha256=digest.hexdigest(), links={"self": here})


@router.get("/{upload_id}", summary="One upload")
def read_upload(services: ServicesNeeded, upload_id: UPLOAD_ID) -> UploadView:
    """Tell whether a file is still there, and its size."""
    path = services.data.upload(upload_id)
    if not _is_name(upload_id) or not path.is_file():
        raise NotFound("upload", upload_id)
    return UploadView(id=upload_id, bytes=path.stat().st_size, links={"self": f"{BASE}/uploads/{upload_id}"})


@router.delete("/{upload_id}", status_code=204, summary="Forget an upload")
def delete_upload(services: ServicesNeeded, upload_id: UPLOAD_ID) -> Response:
    """Delete the file; nothing happens when there is none. One that an import has still to read stays."""
    with suppress(NotFound):
        deletion.delete_upload(services.database, services.data, upload_id)
    return Response(status_code=204)


def _promised(services: Services) -> int:
    with services.database.read() as session:
        return promised(session, services.data)


def _is_name(upload_id: str) -> bool:
    return upload_id.isascii() and upload_id.isalnum()


def _finish(file: BinaryIO, draft: Path, path: Path) -> None:
    """Give a file that has come whole its name; from then on it survives a power cut."""
    file.flush()
    os.fsync(file.fileno())
    os.replace(draft, path)
    sync_folder(path.parent)
