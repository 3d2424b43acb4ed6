"""Authentication middleware and the table of scopes per route.

No handler takes a scope, a principal or a key as a parameter: the principal is put into the request's scope by
:class:`AuthenticationMiddleware`, and :class:`AuthorizedRoute` compares it with the table.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import Any, Final, Protocol
from urllib.parse import urlsplit

from fastapi import Request, Response
from fastapi.routing import APIRoute
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Receive, Scope, Send

from steradian.api.background.peers import ForwardToPeer, principal_of
from steradian.api.errors.handlers import DATABASE_ERRORS, database_problem, problem_response
from steradian.api.http.proxy_detection import is_forwarded, stranger
from steradian.api.http.session_cookie import check_same_origin, session_secret
from steradian.api.middleware.cors import is_read_of
from steradian.api.middleware.json_body import StrictJsonRequest
from steradian.api.middleware.stop_authorization import bearer_of_ticket, is_stop
from steradian.api.params.filters import reject_unknown_query_params
from steradian.core.settings import Settings
from steradian.security.keys import Forbidden, KeyStore, Principal, Unauthorized
from steradian.security.keys import Scope as Need
from steradian.security.rate_limit import RateLimiter, RateLimitExceeded
from steradian.security.sessions import SessionStore, ValidSession
from steradian.security.stop_tickets import StopTickets

V1: Final = "/api/v1"
PUBLIC: Final = None
"""Any authenticated caller, whatever the scopes of the key."""

SCOPES: Final[dict[tuple[str, str], Need | None]] = {
    ("GET", V1): Need.READ,
    ("GET", f"{V1}/storage"): Need.READ,
    ("GET", f"{V1}/"): Need.READ,
    ("POST", f"{V1}/masks"): Need.PLAN,
    ("POST", f"{V1}/masks/preview"): Need.PLAN,
    ("GET", f"{V1}/masks"): Need.READ,
    ("GET", f"{V1}/masks/{{mask_id}}"): Need.READ,
    ("DELETE", f"{V1}/masks/{{mask_id}}"): Need.PLAN,
    ("GET", f"{V1}/masks/{{mask_id}}/points"): Need.READ,
    ("GET", f"{V1}/masks/{{mask_id}}/picture"): Need.READ,
    ("POST", f"{V1}/plans"): Need.PLAN,
    ("POST", f"{V1}/plans/preview"): Need.PLAN,
    ("POST", f"{V1}/designs/preview"): Need.PLAN,
    ("POST", f"{V1}/designs/point-spread"): Need.PLAN,
    ("POST", f"{V1}/designs/budget"): Need.PLAN,
    ("GET", f"{V1}/plans"): Need.READ,
    ("GET", f"{V1}/plans/{{plan_id}}"): Need.READ,
    ("DELETE", f"{V1}/plans/{{plan_id}}"): Need.PLAN,
    ("GET", f"{V1}/scanners"): Need.READ,
    ("GET", f"{V1}/scanners/{{scanner_id}}"): Need.READ,
    ("DELETE", f"{V1}/scanners/{{scanner_id}}"): Need.ADMIN,
    ("PUT", f"{V1}/scanners/{{scanner_id}}/lease"): Need.OPERATE,
    ("DELETE", f"{V1}/scanners/{{scanner_id}}/lease"): Need.OPERATE,
    ("POST", f"{V1}/scanners/{{scanner_id}}/emergency-stop"): PUBLIC,
    ("POST", f"{V1}/emergency-stop"): PUBLIC,
    ("GET", f"{V1}/emergency-stop"): PUBLIC,
    ("DELETE", f"{V1}/scanners/{{scanner_id}}/emergency-stop"): Need.OPERATE,
    ("POST", f"{V1}/scanners/{{scanner_id}}/clear-fault"): Need.OPERATE,
    ("POST", f"{V1}/scans"): Need.OPERATE,
    ("GET", f"{V1}/scans"): Need.READ,
    ("GET", f"{V1}/scans/{{scan_id}}"): Need.READ,
    ("DELETE", f"{V1}/scans/{{scan_id}}"): Need.OPERATE,
    ("PATCH", f"{V1}/scans/{{scan_id}}"): Need.OPERATE,
    ("PUT", f"{V1}/scans/{{scan_id}}/desired-state"): Need.OPERATE,
    ("PUT", f"{V1}/scans/{{scan_id}}/stages/{{number}}"): Need.OPERATE,
    ("GET", f"{V1}/scans/{{scan_id}}/file"): Need.READ,
    ("GET", f"{V1}/scans/{{scan_id}}/shots"): Need.READ,
    ("GET", f"{V1}/scans/{{scan_id}}/signals"): Need.READ,
    ("GET", f"{V1}/scans/{{scan_id}}/alines"): Need.READ,
    ("GET", f"{V1}/scans/{{scan_id}}/alines/latest"): Need.READ,
    ("GET", f"{V1}/scans/{{scan_id}}/coverage"): Need.READ,
    ("POST", f"{V1}/reconstructions"): Need.RECONSTRUCT,
    ("GET", f"{V1}/reconstructions"): Need.READ,
    ("GET", f"{V1}/reconstructions/{{reconstruction_id}}"): Need.READ,
    ("DELETE", f"{V1}/reconstructions/{{reconstruction_id}}"): Need.RECONSTRUCT,
    ("PATCH", f"{V1}/reconstructions/{{reconstruction_id}}"): Need.RECONSTRUCT,
    ("GET", f"{V1}/reconstructions/{{reconstruction_id}}/mip"): Need.READ,
    ("GET", f"{V1}/reconstructions/{{reconstruction_id}}/volume"): Need.READ,
    ("GET", f"{V1}/reconstructions/{{reconstruction_id}}/volume.ome.zarr/{{path}}"): Need.READ,
    ("POST", f"{V1}/batches"): Need.RECONSTRUCT,
    ("GET", f"{V1}/batches"): Need.READ,
    ("GET", f"{V1}/batches/{{batch_id}}"): Need.READ,
    ("DELETE", f"{V1}/batches/{{batch_id}}"): Need.RECONSTRUCT,
    ("PUT", f"{V1}/batches/{{batch_id}}/desired-state"): Need.RECONSTRUCT,
    ("POST", f"{V1}/reconstructions/{{reconstruction_id}}/quality"): Need.RECONSTRUCT,
    ("GET", f"{V1}/reconstructions/{{reconstruction_id}}/quality"): Need.READ,
    ("GET", f"{V1}/reconstructions/{{reconstruction_id}}/revision"): Need.READ,
    ("PUT", f"{V1}/reconstructions/{{reconstruction_id}}/measurements"): Need.RECONSTRUCT,
    ("GET", f"{V1}/reconstructions/{{reconstruction_id}}/measurements"): Need.READ,
    ("POST", f"{V1}/uploads"): Need.RECONSTRUCT,
    ("GET", f"{V1}/uploads/{{upload_id}}"): Need.READ,
    ("POST", f"{V1}/uploads/{{upload_id}}/preview"): Need.RECONSTRUCT,
    ("PATCH", f"{V1}/uploads/{{upload_id}}"): Need.RECONSTRUCT,
    ("DELETE", f"{V1}/uploads/{{upload_id}}"): Need.RECONSTRUCT,
    ("POST", f"{V1}/jobs"): Need.RECONSTRUCT,
    ("GET", f"{V1}/jobs"): Need.READ,
    ("GET", f"{V1}/jobs/{{job_id}}"): Need.READ,
    ("DELETE", f"{V1}/jobs/{{job_id}}"): Need.RECONSTRUCT,
    ("PATCH", f"{V1}/jobs/{{job_id}}"): Need.RECONSTRUCT,
    ("PUT", f"{V1}/jobs/{{job_id}}/desired-state"): Need.RECONSTRUCT,
    ("GET", f"{V1}/jobs/{{job_id}}/attempts"): Need.READ,
    ("GET", f"{V1}/jobs/{{job_id}}/log"): Need.READ,
    ("GET", f"{V1}/jobs/{{job_id}}/files/{{name}}"): Need.READ,
    ("POST", f"{V1}/session"): PUBLIC,
    ("GET", f"{V1}/session"): PUBLIC,
    ("DELETE", f"{V1}/session"): PUBLIC,
    ("GET", f"{V1}/events"): Need.READ,
    ("GET", "/metrics"): Need.READ,
}
"""What a key must allow for each route."""

SCOPED_ROUTES: Final = (V1, "/metrics")
"""Paths below which nothing is answered without a key; the rest (health, documentation, pages) holds no data."""
MUTATING_METHODS: Final = frozenset({"POST", "PUT", "PATCH", "DELETE"})
LOOPBACK: Final = Principal("local", frozenset({Need.ADMIN}))
BURST: Final = 10.0
"""Seconds' worth of requests that may come at once."""
WRITE_COST: Final = 5.0
"""What a request that changes something costs of a key's rate; one that reads costs 1."""


class _AuthBackend(Protocol):
    settings: Settings
    keys: KeyStore
    sessions: SessionStore
    stop_tickets: StopTickets


class AuthenticationMiddleware:
    """ASGI middleware that identifies the caller by key, session, stop ticket or loopback connection.

    Missing or invalid credentials are rejected before the body is read.

    Without keys only this machine can connect, but a proxy on it or a page in its browser could connect for others. So
    forwarded requests need a key, and so do requests of another user's process, except emergency stops. Requests to
    another host name, and requests that a page of another origin makes by itself, are rejected.
    """

    def __init__(self, app: ASGIApp, keeper: _AuthBackend) -> None:
        self.app, self._settings = app, keeper.settings
        self._keys, self._sessions, self._tickets = keeper.keys, keeper.sessions, keeper.stop_tickets
        per_second, failed = keeper.settings.requests_per_second, keeper.settings.failed_keys_per_minute
        self._asked, self._failed = RateLimiter(per_second, BURST * per_second), RateLimiter(failed / 60, failed)
        self._hosts = {name.strip() for name in keeper.settings.allowed_hosts.split(",") if name.strip()}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Authenticate the request, apply the rate limit of its caller, and pass the request on."""
        if scope["type"] == "http":
            try:
                scope["state"]["principal"] = principal = await self._principal(scope)
                counts = not (is_stop(scope) or scope["state"].get("forwarded"))
                if principal is not None and principal is not LOOPBACK and counts:
                    self._asked.acquire(principal.name, WRITE_COST if scope["method"] in MUTATING_METHODS else 1.0)
            except Unauthorized as error:
                headers = {"WWW-Authenticate": 'Bearer realm="steradian"', "Connection": "close"}
                answer = problem_response(scope, error.code, str(error), headers=headers)
                return await answer(scope, receive, send)
            except RateLimitExceeded as error:
                headers = {"Retry-After": str(error.retry_after)}
                answer = problem_response(scope, error.code, str(error), headers=headers)
                return await answer(scope, receive, send)
            except Forbidden as error:
                answer = problem_response(scope, error.code, str(error))
                return await answer(scope, receive, send)
            except DATABASE_ERRORS as error:
                answer = await database_problem(Request(scope), error)
                return await answer(scope, receive, send)
        return await self.app(scope, receive, send)

    async def _principal(self, scope: Scope) -> Principal | None:
        headers, path = Headers(scope=scope), scope["path"]
        given = headers.get("authorization", "")
        if not any(path == root or path.startswith(f"{root}/") for root in SCOPED_ROUTES):
            return None
        if (asking := principal_of(headers, self._settings.node_secret)) is not None:
            scope["state"]["forwarded"] = True
            return asking
        if (bearer := bearer_of_ticket(scope, self._keys, self._sessions, self._tickets)) is not None:
            return bearer
        if given:
            kind, _, key = given.partition(" ")
            if kind.lower() != "bearer":
                raise Unauthorized("send the key as Authorization: Bearer …")
            if is_stop(scope) and (known := self._keys.check_cached(key.strip())) is not None:
                return known
            return await self._prove(scope, key.strip())
        if (secret := session_secret(headers)) and (seen := await self._recognise(scope, secret)):
            check_same_origin(seen, headers, changes=scope["method"] in MUTATING_METHODS)
            scope["state"]["session"] = seen
            return seen.principal
        if self._settings.needs_key:
            raise Unauthorized("a key is needed: Authorization: Bearer …")
        if is_forwarded(scope):
            raise Unauthorized("the request came through a proxy, so a key is needed: Authorization: Bearer …")
        if not is_stop(scope) and (why := stranger(scope)) is not None:
            raise Unauthorized(f"{why}, so a key is needed: Authorization: Bearer …")
        self._check_origin(scope, headers)
        return LOOPBACK

    async def _prove(self, scope: Scope, key: str) -> Principal:
        """Return the principal of a key; an address with too many failures may use cached keys only."""
        address = (scope.get("client") or ("",))[0]
        if self._failed.is_exhausted(address) and not (is_stop(scope) and scope["method"] == "POST"):
            if (known := self._keys.check_cached(key)) is not None:
                return known
            raise RateLimitExceeded(60 / self._settings.failed_keys_per_minute)
        try:
            return await run_in_threadpool(self._keys.check, key)
        except Unauthorized:
            with suppress(RateLimitExceeded):
                self._failed.acquire(address)
            raise

    async def _recognise(self, scope: Scope, secret: str) -> ValidSession | None:
        """Return the session of a secret; ``None`` if it has ended, so that the request is handled as anonymous."""
        with suppress(Unauthorized):
            if is_stop(scope):
                with suppress(Unauthorized):
                    return self._sessions.check_cached(secret)
            return await run_in_threadpool(self._sessions.check, secret)
        return None

    def _check_origin(self, scope: Scope, headers: Headers) -> None:
        method = scope["method"]
        hosts = headers.getlist("host")
        host = hosts[0] if len(hosts) == 1 else ""
        name = _name(f"//{host}")
        if not (_is_loopback(name) or name in self._hosts):
            raise Forbidden(f"this service is not addressed as {host!r} without a key")
        origin = headers.get("origin")
        if method in MUTATING_METHODS and origin is not None and origin.partition("://")[2] != host:
            raise Forbidden(f"a page of {origin!r} may not change anything here without a key")
        if is_read_of(scope, headers, self._settings.origins):
            return
        followed = method not in MUTATING_METHODS and headers.get("sec-fetch-mode") == "navigate"
        if headers.get("sec-fetch-site", "none") not in {"same-origin", "none"} and not followed:
            raise Forbidden("a page of another origin may do nothing here without a key")


def _name(address: str) -> str:
    """Return the host name in an address; empty if the address is invalid."""
    try:
        parts = urlsplit(address)
        _ = parts.port
        return parts.hostname or "" if parts.username is None else ""
    except ValueError:
        return ""


def _is_loopback(name: str) -> bool:
    try:
        return name == "localhost" or ipaddress.ip_address(name).is_loopback
    except ValueError:
        return False


class AuthorizedRoute(APIRoute):
    """APIRoute that checks the scope before the body is read."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the route's handler, wrapped in checks of scope, query parameters and JSON body."""
        handle = super().get_route_handler()

        async def guarded(request: Request) -> Response:
            need = SCOPES[request.method, self.path_format]
            principal: Principal | None = request.state.principal
            if principal is None:
                raise Unauthorized("a key is needed")
            if need is not None and not principal.may(need):
                raise Forbidden(f"this needs a key with the scope {need}")
            reject_unknown_query_params(request, self.dependant)
            checked = StrictJsonRequest(request.scope, request.receive)
            try:
                answer = await handle(checked)
            except HTTPException:
                if checked.refusal is not None:
                    raise checked.refusal from None
                raise
            except ForwardToPeer as error:
                return await request.app.state.services.nodes.forward(checked, error.scanner_id)  # type: ignore[no-any-return]
            if applied := getattr(request.state, "preference_applied", None):
                answer.headers["Preference-Applied"] = applied
            return answer

        return guarded
