"""Exception handlers that map errors to RFC 9457 problem responses.

Exceptions of this software are mapped by their code and the catalogue of problem types. An unexpected exception is a
500 without internal details; the log has them under the request's id.
"""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from pydantic import BaseModel, Field
from sqlalchemy.exc import DBAPIError, OperationalError
from sqlalchemy.exc import TimeoutError as NoConnection
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.routing import Match
from starlette.types import Scope

from steradian.api.errors.catalog import PROBLEM_TYPES, problem_type_uri
from steradian.api.errors.field_errors import Finding, field_error, field_errors
from steradian.api.http.conditional import NotModified
from steradian.api.http.security_headers import NO_STORE, SECURITY_HEADERS
from steradian.api.http.urls import address, link
from steradian.core.exceptions import Conflict, DiskFull, InvalidInput, NotFound, SteradianError
from steradian.scans.file.create import is_disk_full_error
from steradian.storage.repositories.deletion import HasDependents

MEDIA_TYPE = "application/problem+json"
_log = logging.getLogger(__name__)


class NotReady(Conflict):
    """Error: the requested result does not exist until its job or scan has ended."""

    code = "not-ready"

    def __init__(self, message: str, retry_after: int = 1) -> None:
        self.retry_after = retry_after
        super().__init__(message)


_NOUNS = {kind: f"{kind}s" for kind in ("mask", "plan", "scan", "reconstruction", "job")} | {"batch": "batches"}
MOST_NAMED = 100
"""Dependents that a refusal names at most."""

PROBLEM_BY_STATUS = {
    404: "no-such-route",
    405: "method-not-allowed",
    406: "not-acceptable",
    413: "too-large",
    415: "unsupported-media-type",
    416: "range-not-satisfiable",
}
"""Codes of what the framework refuses by itself, where it is more than a bad request."""


class Problem(BaseModel):
    """Problem document: error response of the API (RFC 9457)."""

    type: str = Field(
        description="URL of the page that explains this kind of problem", examples=["/problems/not-found"]
    )
    title: str = Field(description="Title of this kind of problem", examples=["Resource not found"])
    status: int = Field(examples=[404])
    detail: str = Field(description="Explanation of this occurrence", examples=["there is no mask 'm1'"])
    instance: str = Field(description="Path of the request, without the query", examples=["/api/v1/masks/m1"])
    code: str = Field(description="Stable name of this kind of problem", examples=["not-found"])
    request_id: str = Field(
        description="Identifier of the request, also in the X-Request-ID header and in the service's log"
    )
    retryable: bool = Field(description="Whether the same request may succeed later")
    errors: list[Finding] = Field(default_factory=list, description="Invalid fields")
    dependents: list[str] | None = Field(
        default=None, description="Resources that depend on the resource to delete (409)"
    )
    needed_bytes: int | None = Field(default=None, description="Bytes that the request needs (507)")
    available_bytes: int | None = Field(default=None, description="Bytes available for the request (507)")


_REFUSALS: dict[str, str] = {
    "400": "Malformed JSON body or malformed request",
    "401": "Authentication required: the key is missing, unknown, revoked or expired",
    "403": "Permission denied",
    "404": "Resource not found",
    "406": "No acceptable representation",
    "409": "Conflict with the current state",
    "412": "Precondition failed: the resource was modified since the ETag in If-Match",
    "413": "Request body too large",
    "415": "Unsupported media type: the body must be application/json",
    "416": "Range not satisfiable",
    "422": "Invalid input",
    "429": "Too many requests; retry after Retry-After seconds",
    "5XX": "Internal server error; the log has the details under request_id",
}
DATABASE_ERRORS: Final = (DBAPIError, NoConnection)
"""What is raised where the database does not answer: by itself, or as all connections to it are busy."""
RESPONSES: dict[str, dict[str, Any]] = {
    status: {"description": text, "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}}
    for status, text in _REFUSALS.items()
}
"""What operations may answer besides their own."""


def install_handlers(app: FastAPI) -> None:
    """Install exception handlers that turn every error of an application into a problem document."""
    app.add_exception_handler(SteradianError, _handle_domain_error)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(HTTPException, _handle_http_error)
    app.add_exception_handler(NotModified, _not_modified)
    for kind in DATABASE_ERRORS:
        app.add_exception_handler(kind, database_problem)
    app.add_exception_handler(OSError, _system_problem)
    app.add_exception_handler(ClientDisconnect, _handle_disconnect)
    app.add_exception_handler(Exception, _unexpected)


def problem_response(
    scope: Scope,
    code: str,
    detail: str,
    *,
    errors: list[Finding] | None = None,
    headers: dict[str, str] | None = None,
    **more: Any,
) -> JSONResponse:
    """Build the problem document that answers a request; ``more`` are further members of :class:`Problem`."""
    kind, request_id = PROBLEM_TYPES[code], request_id_of(scope)
    body = Problem(
        type=address(problem_type_uri(code)),
        title=kind.title,
        status=kind.status,
        detail=detail,
        instance=address(quote(scope["path"])),  # the query may hold a secret
        code=code,
        request_id=request_id,
        retryable=kind.retryable,
        errors=errors or [],
        **more,
    )
    return JSONResponse(
        body.model_dump(mode="json", exclude_defaults=False),
        kind.status,
        # Those of a failure pass no layer of ours that could add them.
        headers=SECURITY_HEADERS | {"Cache-Control": NO_STORE} | (headers or {}) | {"X-Request-ID": request_id},
        media_type=MEDIA_TYPE,
    )


def request_id_of(scope: Scope) -> str:
    """Return the identifier (X-Request-ID) that :class:`RequestIdMiddleware` assigned to a request."""
    return str(scope.get("state", {}).get("request_id", ""))


async def _handle_domain_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, SteradianError)  # noqa: S101 - installed for it only
    if error.code not in PROBLEM_TYPES:
        return await _unexpected(request, error)
    errors = [field_error(error, request)] if isinstance(error, InvalidInput) else []
    headers = {"Retry-After": str(getattr(error, "retry_after", 1))} if PROBLEM_TYPES[error.code].retryable else {}
    more: dict[str, Any] = {}
    if isinstance(error, DiskFull):
        more = {"needed_bytes": error.needed, "available_bytes": error.available}
    elif isinstance(error, HasDependents):
        more = {"dependents": [link(f"/{_NOUNS[one.kind]}/{one.id}") for one in error.dependents[:MOST_NAMED]]}
    return problem_response(request.scope, error.code, str(error), errors=errors, headers=headers, **more)


async def _invalid(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)  # noqa: S101
    raw = error.errors()
    if raw and raw[0]["type"] == "json_invalid":
        reason = raw[0].get("ctx", {}).get("error", "")
        return problem_response(request.scope, "malformed-json", f"the body is not valid JSON: {reason}")
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if raw and raw[0]["loc"][:1] == ("body",) and error.body is not None and not _is_json(kind):
        text = f"the body is {kind or 'of no stated type'}; send Content-Type: application/json (curl --json)"
        return problem_response(request.scope, PROBLEM_BY_STATUS[415], text)
    errors = field_errors(request, raw, error.body)
    return problem_response(request.scope, "invalid-input", "; ".join(e.detail for e in errors), errors=errors)


async def _handle_http_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)  # noqa: S101
    detail, headers = str(error.detail), dict(error.headers or {})
    if error.status_code == 404:
        detail = f"there is no {request.method} {address(request.url.path)}; the API begins at {link('')}"
    elif error.status_code == 405:
        headers["Allow"] = ", ".join(sorted(_methods(request)))
        detail = f"{address(request.url.path)} does not accept {request.method}; allowed: {headers['Allow']}"
    return problem_response(
        request.scope, PROBLEM_BY_STATUS.get(error.status_code, "bad-request"), detail, headers=headers
    )


def _methods(request: Request) -> set[str]:
    """Return the HTTP methods of all routes to the request's path; the router reports only the first route's."""
    routes = [route for route in request.app.state.routes if route.matches(request.scope)[0] is not Match.NONE]
    exact = [route for route in routes if route.path == request.url.path]  # no identifier that happens to look like it
    found = {method for route in exact or routes for method in getattr(route, "methods", None) or ()}
    return found | {"HEAD"} if "GET" in found else found


async def _not_modified(_request: Request, error: Exception) -> Response:
    assert isinstance(error, NotModified)  # noqa: S101
    return Response(status_code=304, headers=error.headers)


async def _handle_disconnect(request: Request, error: Exception) -> Response:
    """Handle a client that disconnected during its request; the response is discarded."""
    _log.info("request %s: the client left before the response", request_id_of(request.scope))
    return Response(status_code=400)


async def _system_problem(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, OSError)  # noqa: S101
    if is_disk_full_error(error):
        return _disk_full(request)
    if isinstance(error, FileNotFoundError) and await run_in_threadpool(_is_deleted, request, error):
        return problem_response(request.scope, NotFound.code, "it was deleted while it was being read")
    return await _unexpected(request, error)


def _is_deleted(request: Request, error: FileNotFoundError) -> bool:
    """Return whether a deleted file of the data folder caused the error, rather than a missing folder."""
    root = request.app.state.services.data.root.absolute()
    name = error.filename  # the HDF5 library tells none
    ours = name is None or Path(os.fsdecode(name)).absolute().is_relative_to(root)
    return request.method in {"GET", "HEAD"} and ours and root.is_dir()


def _disk_full(request: Request) -> JSONResponse:
    _log.error("request %s: the disk is full", request_id_of(request.scope))
    return problem_response(request.scope, DiskFull.code, "the disk is full; nothing of the request was stored")


async def database_problem(request: Request, error: Exception) -> JSONResponse:
    """Convert a database error to a problem document: 503 if unavailable, 500 if a statement was rejected."""
    if isinstance(error, DBAPIError):
        if "disk is full" in str(error.orig):  # SQLITE_FULL
            return _disk_full(request)
        if not (error.connection_invalidated or isinstance(error, OperationalError)) or "no such" in str(error.orig):
            return await _unexpected(request, error)
    _log.warning("the database does not answer: %s", getattr(error, "orig", error))
    detail = "the database does not answer; try again in a moment"
    headers = {"Retry-After": "2"}
    return problem_response(request.scope, "database-unavailable", detail, headers=headers)


async def _unexpected(request: Request, error: Exception) -> JSONResponse:
    request_id = request_id_of(request.scope)
    _log.error("request %s failed", request_id, exc_info=error)
    detail = f"the service failed; its log has more under request {request_id}"
    # The server closes the connection after an exception; a client that is told does not send on it again.
    return problem_response(request.scope, "internal", detail, headers={"Connection": "close"})


def _is_json(kind: str) -> bool:
    return kind == "application/json" or kind.endswith("+json")
