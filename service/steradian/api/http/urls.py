"""Addresses as a client must write them: behind a proxy that serves the service below a path, with that path in front.

The path is the setting ``root_path``, else the header ``X-Forwarded-Prefix`` of the request. It is found once, before
everything else; all that gives an address in an answer asks :func:`address` for it. Inside, no address has it: where a
proxy leaves the setting's path in what it asks for, it is taken off here.
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
    """Return the path below which the client of this request finds the service; empty at the root of a host."""
    return _prefix.get()


def address(path: str) -> str:
    """Return an address of this service, ``/api/v1/…``, as the client of this request must write it."""
    return _prefix.get() + path


def link(path: str) -> str:
    """Return the address of something of the API, ``/scans/…``, as the client of this request must write it."""
    return address(BASE + path)


def stated_prefix(headers: Headers) -> str:
    """Return the path prefix in ``X-Forwarded-Prefix``.

    Empty when the header is missing, repeated or not a plain path.
    """
    given = headers.getlist(HEADER)
    path = given[0].rstrip("/") if len(given) == 1 else ""
    return path if len(path) <= LONGEST and _PATH.fullmatch(path) else ""


class Prefixed:
    """Finds out below which path the service is, and takes it off the request's own.

    Parameters
    ----------
    root_path
        The setting, ``/steradian``; empty: what each request's header says, for addresses in answers alone. Only the
        setting's path is taken off: a header cannot turn one address into another.
    """

    def __init__(self, app: ASGIApp, root_path: str) -> None:
        self.app, self._root = app, root_path.rstrip("/")

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve."""
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
    """Make a path of where the framework redirects to; its host and scheme are those of this side of the proxy."""
    found = re.fullmatch(r"https?://[^/]*(/.*)", headers.get("location", ""))
    if found:
        headers["location"] = address(found[1])
