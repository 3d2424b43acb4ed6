"""File responses with Range support and Repr-Digest (RFC 9530).

A range that cannot be satisfied is answered with a problem document (RFC 9457).
"""

from __future__ import annotations

import base64
import hashlib
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

from fastapi.responses import FileResponse, StreamingResponse
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.types import Message, Receive, Scope, Send

from steradian.core.exceptions import NotFound
from steradian.storage.blobs.interface import BlobStore

RANGED: Final[dict[str, Any]] = {
    "parameters": [
        {
            "name": "Range",
            "in": "header",
            "description": "Which bytes; the answer is 206 with these alone",
            "schema": {"type": "string", "examples": ["bytes=0-1048575"]},
        },
        {
            "name": "If-Range",
            "in": "header",
            "description": "ETag of the partly downloaded file; if it has changed, the response is the whole file",
            "schema": {"type": "string"},
        },
        {
            "name": "Want-Repr-Digest",
            "in": "header",
            "description": "sha-256=1: the response states the checksum of the whole file (RFC 9530)",
            "schema": {"type": "string", "examples": ["sha-256=1"]},
        },
    ]
}
"""What an operation declares that answers with a :class:`RangeFileResponse`."""
PIECE = 2**18
_WANTED = re.compile(r"(?:^|,)\s*sha-256\s*=\s*[1-9]")


def open_or_404(arrays: BlobStore, name: str, what: str, identifier: str) -> Path:
    """Return the local path of a stored file; raises :class:`NotFound` with the name of the resource."""
    try:
        return arrays.open(name)
    except NotFound:
        raise NotFound(what, identifier) from None


class RangeFileResponse(FileResponse):
    """FileResponse that honours Range and Want-Repr-Digest."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the file or the requested range; the response begins once the file is open.

        Raises
        ------
        FileNotFoundError
            When the file has been deleted.
        HTTPException
            416 with the file's size when it ends before the range; 400 when the header is malformed.
        """
        head: list[Message] = []

        async def checked(message: Message) -> None:
            if message["type"] == "http.response.start" and message["status"] in {400, 416}:
                size = Headers(raw=message["headers"]).get("content-range")
                said = f"the file has {size.rpartition('/')[2]} bytes" if size else "send Range: bytes=FIRST-LAST"
                raise HTTPException(message["status"], said, {"Content-Range": size} if size else None)
            if message["type"] == "http.response.start":
                head.append(message)
                return
            while head:
                await send(head.pop())
            await send(message)

        if self.stat_result is None:
            self.stat_result = await run_in_threadpool(os.stat, self.path)
            self.set_stat_headers(self.stat_result)
        if _WANTED.search(Headers(scope=scope).get("want-repr-digest", "")):
            self.headers["Repr-Digest"] = f"sha-256=:{await run_in_threadpool(_sha256, Path(self.path))}:"
        await super().__call__(scope, receive, checked)


def concatenated_log_response(paths: Iterable[Path]) -> StreamingResponse:
    """Return a response that streams several log files as one text, up to their present sizes."""
    logs = [(path, path.stat().st_size) for path in paths]
    headers = {"Content-Length": str(sum(size for _, size in logs))}
    return StreamingResponse(_pieces(logs), headers=headers, media_type="text/plain; charset=utf-8")


def _pieces(logs: Iterable[tuple[Path, int]]) -> Iterator[bytes]:
    for path, size in logs:
        with path.open("rb") as file:
            while piece := file.read(min(PIECE, size)):
                size -= len(piece)
                yield piece


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return base64.b64encode(hashlib.file_digest(file, "sha256").digest()).decode()
