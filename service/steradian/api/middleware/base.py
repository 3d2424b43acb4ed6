"""ASGI middleware: request id, access log, body limits, HEAD, stream limits."""

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

from steradian.api.errors.handlers import PROBLEM_BY_STATUS, problem_response
from steradian.api.http.security_headers import add_security_headers
from steradian.api.middleware.metrics import Metrics
from steradian.api.middleware.stop_authorization import EMERGENCY_STOP
from steradian.core.logging_config import request_id
from steradian.core.settings import Settings

_log = logging.getLogger(__name__)
UPLOADS, STREAMS = "/api/v1/uploads", "/api/v1/events"
_UPLOAD = re.compile(rf"{UPLOADS}(/[^/]+)?")
MAX_STREAMS, MAX_CONCURRENT_OPENS = 200, 4
LISTS = frozenset(
    f"/api/v1/{name}"
    for name in ("masks", "masks/preview", "plans", "plans/preview", "designs/preview", "designs/point-spread")
)
"""Paths whose bodies may hold numbers for each point of a mask."""
JSON_BYTES, MAX_POINTS_BODY_BYTES = 2**20, 128
"""Largest body of any other path, and what those bodies may have more for each point (indented, with all digits)."""
MAX_STOP_BODY_BYTES = 4096
"""The body of an emergency stop holds a reason, nothing else."""
METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
"""Those that the metrics tell apart."""
_REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")


class RequestIdMiddleware:
    """Middleware that assigns X-Request-ID, keeping a valid one of the caller, and adds security headers."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Assign an identifier to the request and pass the request on."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        given = Headers(scope=scope).get("x-request-id", "")
        identifier = given if _REQUEST_ID.fullmatch(given) else str(ULID()).lower()
        scope.setdefault("state", {})["request_id"] = identifier

        async def named(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).setdefault("X-Request-ID", identifier)
                add_security_headers(message)
            await send(message)

        token = request_id.set(identifier)
        try:
            await self.app(scope, receive, named)
        finally:
            request_id.reset(token)


class AccessLogMiddleware:
    """Access log and metrics middleware; queries are omitted because they may contain secrets.

    Successful requests that create or delete a resource, change a desired state or press an emergency stop are logged
    at the level INFO, because other processes continue their work; all others at DEBUG.
    """

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self.app, self._metrics = app, metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, then log the request and count it in the metrics."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        begun, status, made = time.monotonic(), 500, ""
        answered = begun

        async def seen(message: Message) -> None:
            nonlocal status, answered, made
            if message["type"] == "http.response.start":
                status, answered = message["status"], time.monotonic()
                made = Headers(scope=message).get("location", "")
            await send(message)

        try:
            await self.app(scope, receive, seen)
        finally:
            seconds = (answered if answered > begun else time.monotonic()) - begun
            route = getattr(scope.get("route"), "path_format", "none")
            method = scope["method"] if scope["method"] in METHODS else "other"
            self._metrics.observe_request(method, route, status, seconds)
            principal = getattr(scope["state"].get("principal"), "name", "")
            about = {"method": scope["method"], "path": scope["path"], "status": status, "who": principal}
            text = f"{scope['method']} {scope['path']} {status} {1e3 * seconds:.1f} ms{made and f': {made}'}"
            level = logging.INFO if status < 300 and (made or _is_state_change_request(scope)) else logging.DEBUG
            more = {"milliseconds": round(1e3 * seconds, 1)} | ({"location": made} if made else {})
            _log.log(level, "%s", text, extra=about | more)


def _is_state_change_request(scope: Scope) -> bool:
    """Return whether a request deletes a resource, changes a desired state or presses an emergency stop."""
    method, path = scope["method"], scope["path"]
    presses = method == "POST" and EMERGENCY_STOP.fullmatch(path)
    return method == "DELETE" or path.endswith("/desired-state") or bool(presses)


class RejectNulMiddleware:
    """Middleware that rejects URLs that contain U+0000, which PostgreSQL cannot store."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Reject a URL with U+0000; pass other requests on."""
        if scope["type"] != "http" or not ("\0" in scope["path"] or b"%00" in scope["query_string"]):
            return await self.app(scope, receive, send)
        return await problem_response(scope, "not-found", "an address with U+0000 names nothing")(scope, receive, send)


class HeadMiddleware:
    """Middleware that answers HEAD requests with the headers of the GET handler, without producing the body."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Process a HEAD request as GET and send only the headers; pass other requests on."""
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
    """Control-flow exception: the headers of a HEAD response are sent, so the handler can stop."""


class StreamAdmissionMiddleware:
    """Middleware that limits how many event streams are opened at the same time, so that other requests are served.

    It is the outermost middleware, so that waiting event streams cost other requests nothing.
    """

    def __init__(self, app: ASGIApp) -> None:
        self.app, self._turns = app, asyncio.Semaphore(MAX_CONCURRENT_OPENS)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Wait for a slot before an event stream is opened; pass other requests on."""
        if scope["type"] != "http" or not scope["path"].endswith(STREAMS):  # below any path
            return await self.app(scope, receive, send)
        await self._turns.acquire()
        has_turn = True

        def pass_on() -> None:
            nonlocal has_turn
            if has_turn:
                has_turn = False
                asyncio.get_running_loop().call_soon(self._turns.release)  # not at once: a refusal waits for nothing

        async def begin(message: Message) -> None:
            pass_on()
            await send(message)

        try:
            await self.app(scope, receive, begin)
        finally:
            pass_on()


class ShutdownMiddleware:
    """Middleware that answers requests which the server cancels at its shutdown, instead of a traceback in the log."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Process a request; answer 503 when it is cancelled before its response has started."""
        has_started = False

        async def observe(message: Message) -> None:
            nonlocal has_started
            has_started = True
            await send(message)

        try:
            await self.app(scope, receive, observe)
        except asyncio.CancelledError:
            if scope["type"] != "http":
                raise
            _log.warning("%s %s was cancelled by the shutdown", scope["method"], scope["path"])
            if not has_started:
                headers = {"Retry-After": "5", "Connection": "close"}
                text = "the service shut down before the request was complete"
                await problem_response(scope, "shutting-down", text, headers=headers)(scope, receive, send)


class MaxStreamsMiddleware:
    """Middleware that rejects event streams beyond :data:`MAX_STREAMS`."""

    def __init__(self, app: ASGIApp) -> None:
        self.app, self._open = app, 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Reject an event stream when the maximum is open; pass other requests on."""
        if scope["type"] != "http" or scope["path"] != STREAMS:
            return await self.app(scope, receive, send)
        if self._open >= MAX_STREAMS:
            headers, text = {"Retry-After": "5", "Connection": "close"}, f"{MAX_STREAMS} clients listen already"
            return await problem_response(scope, "refused", text, headers=headers)(scope, receive, send)
        self._open += 1
        try:
            await self.app(scope, receive, send)
        finally:
            self._open -= 1


class BodySizeLimitMiddleware:
    """Middleware that rejects request bodies larger than the route allows, before reading if possible."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self.app, self._uploads = app, settings.max_import_bytes
        self._lists = min(settings.max_upload_bytes, JSON_BYTES + MAX_POINTS_BODY_BYTES * settings.max_mask_points)
        self._json = min(settings.max_upload_bytes, JSON_BYTES)

    def _limit(self, path: str) -> int:
        if EMERGENCY_STOP.fullmatch(path):
            return min(self._json, MAX_STOP_BODY_BYTES)
        return self._uploads if _UPLOAD.fullmatch(path) else self._lists if path in LISTS else self._json

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Reject a request with too large a body; pass other requests on."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        limit = self._limit(scope["path"])
        text = f"the body is larger than the {limit} bytes this service takes"
        stated = Headers(scope=scope).get("content-length", "0")
        if not stated.isdecimal() or int(stated) > limit:
            # Not with Connection: close, as a connection that is closed on what is still coming takes the answer along.
            await problem_response(scope, PROBLEM_BY_STATUS[413], text)(scope, receive, send)
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
