"""Files as answers, whole or in ranges; a range that cannot be had is a problem like any other."""

from __future__ import annotations

from typing import Any, Final

from fastapi.responses import FileResponse
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.types import Message, Receive, Scope, Send

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
            "description": "ETag of what you have a part of; if it is another one now, the whole file comes",
            "schema": {"type": "string"},
        },
    ]
}
"""What an operation declares that answers with a :class:`RangedFile`."""


class RangedFile(FileResponse):
    """A file, or the part of it that the Range header asks for."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it.

        Raises
        ------
        HTTPException
            416 with the file's size when it ends before the range; 400 when the header is malformed.
        """

        async def checked(message: Message) -> None:
            if message["type"] == "http.response.start" and message["status"] in {400, 416}:
                size = Headers(raw=message["headers"]).get("content-range")
                said = f"the file has {size.rpartition('/')[2]} bytes" if size else "send Range: bytes=FIRST-LAST"
                raise HTTPException(message["status"], said, {"Content-Range": size} if size else None)
            await send(message)

        await super().__call__(scope, receive, checked)
