"""Cross-origin reads (CORS, Fetch standard) by pages of the origins in the settings, without cookies.

Its purpose is OME-Zarr viewers, which run in a browser as a page of another site and request a volume's metadata and
chunks. They have the permissions of the key that the page sends, or need none on a service without keys.
"""

from __future__ import annotations

from typing import Final

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from steradian.api.http.urls import BASE

READS: Final = frozenset({"GET", "HEAD"})
SENT: Final = "Authorization, If-Match, If-None-Match, If-Range, Range, Want-Repr-Digest, X-Request-ID"
"""Headers that a page may send, beside those that every page may."""
SHOWN: Final = (
    "Accept-Ranges, Content-Encoding, Content-Length, Content-Range, ETag, Link, Preference-Applied, Repr-Digest,"
    " Retry-After, X-Axes, X-Dtype, X-Level, X-Origin, X-Request-ID, X-Row, X-Scale, X-Shape, X-Spacing, X-Window"
)
"""Headers of an answer that a page sees, beside those that every page does."""
MINUTES: Final = "600"
"""Seconds for which a browser need not ask again whether it may ask."""


def is_read_of(scope: Scope, headers: Headers, origins: frozenset[str]) -> bool:
    """Return whether a request is an API read by a page of one of these origins."""
    path = scope["path"]
    is_api = path == BASE or path.startswith(f"{BASE}/")
    return is_api and scope["method"] in READS and headers.get("origin", "").lower() in origins


class Cors:
    """ASGI middleware for cross-origin reads (CORS) from the origins in the settings, without cookies.

    Parameters
    ----------
    origins
        Permitted origins in lower case, such as ``https://viewer.example``; if empty, browsers block all other pages.
    """

    def __init__(self, app: ASGIApp, origins: frozenset[str]) -> None:
        self.app, self._origins = app, origins

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer CORS preflight requests and add CORS headers to the responses of permitted reads."""
        if scope["type"] != "http" or not self._origins:
            return await self.app(scope, receive, send)
        headers = Headers(scope=scope)
        if scope["method"] == "OPTIONS" and "access-control-request-method" in headers:
            asked = {**scope, "method": headers["access-control-request-method"]}
            if is_read_of(asked, headers, self._origins):
                return await Response(status_code=204, headers=_permission(headers))(scope, receive, send)
        is_open = is_read_of(scope, headers, self._origins)

        async def told(message: Message) -> None:
            if message["type"] == "http.response.start":
                answer = MutableHeaders(scope=message)
                answer.add_vary_header("Origin")
                if is_open:
                    answer["Access-Control-Allow-Origin"] = headers["origin"]
                    answer["Access-Control-Expose-Headers"] = SHOWN
                    answer["Cross-Origin-Resource-Policy"] = "cross-origin"
            await send(message)

        return await self.app(scope, receive, told)


def _permission(headers: Headers) -> dict[str, str]:
    """Return the headers that answer a CORS preflight request."""
    permission = {
        "Access-Control-Allow-Origin": headers["origin"],
        "Access-Control-Allow-Methods": ", ".join(sorted(READS)),
        "Access-Control-Allow-Headers": SENT,
        "Access-Control-Max-Age": MINUTES,
        "Vary": "Origin, Access-Control-Request-Method, Access-Control-Request-Headers",
    }
    if headers.get("access-control-request-private-network") == "true":
        permission["Access-Control-Allow-Private-Network"] = "true"
    return permission
