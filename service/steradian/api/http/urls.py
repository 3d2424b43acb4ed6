"""URL paths with the path prefix of a reverse proxy, as the client must write them.

The prefix is the setting ``root_path``, else the request's header ``X-Forwarded-Prefix``. It is determined once for
each request, before all middleware; every address in a response comes from :func:`address`. Inside the service, paths
have no prefix: if a proxy forwards paths with the setting's prefix, :class:`PathPrefixMiddleware` strips it.
"""

from __future__ import annotations

import re
from contextvars import ContextVar
from typing import Final

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from steradian.core.settings import ROOT_PATH

BASE: Final = "/api/v1"
HEADER: Final = "x-forwarded-prefix"
LONGEST: Final = 200
_PATH: Final = re.compile(ROOT_PATH)
_prefix: ContextVar[str] = ContextVar("prefix", default="")


def prefix() -> str:
    """Return the path prefix of the present request; empty at the root of a host."""
    return _prefix.get()


def address(path: str) -> str:
    """Return a path of this service, ``/api/v1/…``, with the path prefix of the present request."""
    return _prefix.get() + path


def link(path: str) -> str:
    """Return the path of an API resource, ``/scans/…``, with API root and the path prefix of the present request."""
    return address(BASE + path)


def stated_prefix(headers: Headers) -> str:
    """Return the path prefix in a request's ``X-Forwarded-Prefix`` header.

    Empty when the header is missing, repeated or not a plain path.
    """
    given = headers.getlist(HEADER)
    path = given[0].rstrip("/") if len(given) == 1 else ""
    return path if len(path) <= LONGEST and _PATH.fullmatch(path) else ""


class PathPrefixMiddleware:
    """ASGI middleware that determines the path prefix of a reverse proxy and strips it from request paths.

    Parameters
    ----------
    root_path
        The setting, such as ``/steradian``. If empty, the header of each request gives the prefix, which is then used
        in responses only. Only the setting's prefix is stripped, so that a header cannot turn one path into another.
    """

    def __init__(self, app: ASGIApp, root_path: str) -> None:
        self.app, self._root = app, root_path.rstrip("/")

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Process the request without the path prefix and pass it on."""
        if scope["type"] != "http":
            return await self.app(scope, receive, send)
        root = self._root
        token = _prefix.set(root or stated_prefix(Headers(scope=scope)))

        async def plain(message: Message) -> None:
            if message["type"] == "http.response.start":
                _shorten(MutableHeaders(scope=message))
            await send(message)

        try:
            if root and scope["path"] == root:
                return await RedirectResponse(f"{root}/", 308)(scope, receive, send)
            if root and scope["path"].startswith(f"{root}/"):
                scope["path"] = scope["path"].removeprefix(root)
                scope["raw_path"] = scope["raw_path"].removeprefix(root.encode())
            await self.app(scope, receive, plain)
        finally:
            _prefix.reset(token)


def _shorten(headers: MutableHeaders) -> None:
    """Replace the absolute URL of a redirect by a path, because its host and scheme are those behind the proxy."""
    found = re.fullmatch(r"https?://[^/]*(/.*)", headers.get("location", ""))
    if found:
        headers["location"] = address(found[1])
