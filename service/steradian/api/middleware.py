"""What every request passes first: an identifier, a line in the log and the metrics, a limit on its body."""

from __future__ import annotations

import asyncio
import logging
import re
import time
from contextlib import suppress

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from ulid import ULID

from steradian.api.headers import complete
from steradian.api.metrics import Metrics
from steradian.api.problems import CODE_OF, problem
from steradian.api.security import EMERGENCY_STOP
from steradian.runtime.logs import request_id
from steradian.settings import Settings

_log = logging.getLogger(__name__)
UPLOADS, STREAMS = "/api/v1/uploads", "/api/v1/events"
MAX_STREAMS, OPENING = 200, 4
LISTS = frozenset({"/api/v1/masks", "/api/v1/masks/preview", "/api/v1/plans", "/api/v1/plans/preview"})
"""Paths whose bodies may hold numbers for each point of a mask."""
JSON_BYTES, POINT_BYTES = 2**20, 128
"""Largest body of any other path, and what those bodies may have more for each point (indented, with all digits)."""
STOP_BYTES = 4096
"""The body of an emergency stop holds a reason, nothing else."""
METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
"""Those that the metrics tell apart."""
_REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")


class RequestId:
    """Gives each request an identifier, the caller's own where it is a decent one, and each answer its safe headers."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        given = Headers(scope=scope).get("x-request-id", "")
        identifier = given if _REQUEST_ID.fullmatch(given) else str(ULID()).lower()
        scope.setdefault("state", {})["request_id"] = identifier

        async def named(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).setdefault("X-Request-ID", identifier)
                complete(message)
            await send(message)

        token = request_id.set(identifier)
        try:
            await self.app(scope, receive, named)
        finally:
            request_id.reset(token)


class Observe:
    """Counts each request and writes a line about it; neither holds its query, where a ticket may stand."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self.app, self._metrics = app, metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        begun, status = time.monotonic(), 500
        answered = begun

        async def seen(message: Message) -> None:
            nonlocal status, answered
            if message["type"] == "http.response.start":
                status, answered = message["status"], time.monotonic()
            await send(message)

        try:
            await self.app(scope, receive, seen)
        finally:
            seconds = (answered if answered > begun else time.monotonic()) - begun
            route = getattr(scope.get("route"), "path_format", "none")
            method = scope["method"] if scope["method"] in METHODS else "other"
            self._metrics.count(method, route, status, seconds)
            principal = getattr(scope["state"].get("principal"), "name", "")
            about = {"method": scope["method"], "path": scope["path"], "status": status, "who": principal}
            text = f"{scope['method']} {scope['path']} {status} {1e3 * seconds:.1f} ms"
            _log.debug("%s", text, extra=about | {"milliseconds": round(1e3 * seconds, 1)})


class OnlyText:
    """Refuses addresses that hold U+0000, which PostgreSQL keeps nowhere, so that nothing can be called so."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve."""
        if scope["type"] != "http" or not ("\0" in scope["path"] or b"%00" in scope["query_string"]):
            return await self.app(scope, receive, send)
        return await problem(scope, "not-found", "an address with U+0000 names nothing")(scope, receive, send)


class Head:
    """Answers HEAD as GET is answered, without the body, which is not even made where it comes in pieces."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            return await self.app(scope, receive, send)

        async def without_body(message: Message) -> None:
            if message["type"] == "http.response.start":
                return await send(message)
            await send({"type": "http.response.body", "body": b""})
            raise _HeadersSent

        inner = {**scope, "method": "GET"}  # the server looks at its own
        with suppress(_HeadersSent):
            await self.app(inner, receive, without_body)
        scope["route"] = inner.get("route")


class _HeadersSent(Exception):
    """There is nothing more to send."""


class StreamLimit:
    """Counts event streams before they are accepted; one too many is refused before anything is looked at.

    Few open at a time, so that others are served between those of a crowd.
    """

    def __init__(self, app: ASGIApp) -> None:
        self.app, self._open = app, 0
        self._turns = asyncio.Semaphore(OPENING)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve."""
        if scope["type"] != "http" or scope["path"] != STREAMS:
            return await self.app(scope, receive, send)
        if self._open >= MAX_STREAMS:
            headers, text = {"Retry-After": "5", "Connection": "close"}, f"{MAX_STREAMS} clients listen already"
            return await problem(scope, "refused", text, headers=headers)(scope, receive, send)
        opened = False

        async def begin(message: Message) -> None:
            nonlocal opened
            if not opened:
                opened = True
                self._turns.release()
            await send(message)

        self._open += 1
        try:
            await self._turns.acquire()
            try:
                return await self.app(scope, receive, begin)
            finally:
                if not opened:
                    self._turns.release()
        finally:
            self._open -= 1


class BodyLimit:
    """Refuses bodies larger than what is asked for there can be, before reading where that is stated."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self.app, self._uploads = app, settings.max_import_bytes
        self._lists = min(settings.max_upload_bytes, JSON_BYTES + POINT_BYTES * settings.max_mask_points)
        self._json = min(settings.max_upload_bytes, JSON_BYTES)

    def _limit(self, path: str) -> int:
        if EMERGENCY_STOP.fullmatch(path):
            return min(self._json, STOP_BYTES)
        return self._uploads if path == UPLOADS else self._lists if path in LISTS else self._json

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        limit = self._limit(scope["path"])
        text = f"the body is larger than the {limit} bytes this service takes"
        stated = Headers(scope=scope).get("content-length", "0")
        if not stated.isdecimal() or int(stated) > limit:
            # Not with Connection: close, as a connection that is closed on what is still coming takes the answer along.
            await problem(scope, CODE_OF[413], text)(scope, receive, send)
            return
        taken = 0

        async def counted() -> Message:
            nonlocal taken
            message = await receive()
            taken += len(message.get("body", b""))
            if taken > limit:
                raise HTTPException(413, text)
            return message

        await self.app(scope, counted, send)
