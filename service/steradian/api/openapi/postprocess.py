"""Post-processing of the generated OpenAPI document: operation ids, errors, headers, security and tags.

Most additions are derived from the parameters that an operation declares, so that they need no second declaration.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from fastapi import FastAPI
from fastapi.routing import APIRoute

from steradian.api.errors.handlers import RESPONSES, Problem
from steradian.api.http import session_cookie as cookies
from steradian.api.http.array_response import NPY, RAW
from steradian.api.http.urls import prefix
from steradian.api.middleware.authentication import SCOPED_ROUTES
from steradian.api.middleware.stop_authorization import STOP_TICKET
from steradian.api.openapi.links import add_links

TAGS: Final = [
    {"name": "service", "description": "The service's version, limits and entry points"},
    {"name": "masks", "description": "Where to sense: arrangements of points on the film"},
    {"name": "plans", "description": "Order and timing of a mask's measurement, and its cost"},
    {"name": "designs", "description": "Masks and plans that are only thought about: nothing is stored"},
    {"name": "scanners", "description": "The scanner, its lease, and the emergency stop"},
    {"name": "scans", "description": "Runs of plans and the A-lines that they measured"},
    {"name": "reconstructions", "description": "Volumes made of scans, their projections and quality"},
    {"name": "batches", "description": "Many reconstructions of one scan as one request"},
    {"name": "jobs", "description": "The queue: state, attempts, log and files of each job; uploads for imports"},
    {"name": "events", "description": "Event stream"},
    {"name": "health", "description": "Health checks and metrics"},
]
SECURITY: Final = {
    "key": {
        "type": "http",
        "scheme": "bearer",
        "description": "An API key (`steradian key create`). Not needed on a service that only its own machine reaches",
    },
    "session": {
        "type": "apiKey",
        "in": "cookie",
        "name": cookies.NAME,
        "description": f"Browser session (POST /session); requests that change state also send {cookies.TOKEN}, too",
    },
    "stop-ticket": {
        "type": "apiKey",
        "in": "header",
        "name": STOP_TICKET,
        "description": "A stop ticket (GET /session), good for 7 days for the emergency stop and nothing else",
    },
}
CONFLICT_CODES: Final = frozenset(
    {
        *("batch_create", "batch_delete", "batch_desired_state_set"),
        *("emergency_stop_release", "scanner_lease_return", "scanner_lease_take", "scanner_retire"),
        *("job_change", "job_create", "job_delete", "job_desired_state_set", "job_file_read"),
        *("mask_delete", "plan_delete", "upload_append", "upload_delete"),
        *("reconstruction_change", "reconstruction_create", "reconstruction_delete"),
        *("reconstruction_measurements_set", "reconstruction_mip_read", "reconstruction_quality_create"),
        *("reconstruction_revision_read", "reconstruction_volume_read", "reconstruction_zarr_read"),
        *("scan_create", "scan_delete", "scan_desired_state_set", "scan_file_read", "scan_stage_set"),
        "scan_latest_aline_read",
    }
)
"""Operations that a state of things can stand against."""
OPERATION_NAMES: Final = frozenset(
    {"plan_create", "plan_preview", "scan_create", "batch_create", "reconstruction_create"}
)
"""Operations without an identifier in their path whose body names what must exist; beside ``job_create``."""
BY_STOP_TICKET: Final = frozenset({"emergency_stop_press", "emergency_stops_press", "emergency_stops_read"})
"""Operations that a stop ticket is good for."""
RESPONSE_HEADERS: Final[dict[str, tuple[str, str]]] = {
    "Accept-Ranges": ("Byte ranges are supported", "bytes"),
    "Cache-Control": ("Caching rules; responses with an ETag may be cached and revalidated", "no-store"),
    "Content-Range": ("Which bytes of how many these are", "bytes 0-99/1000"),
    "ETag": ("Version of this representation", '"s01jz0000000000000000000000-3-6c0b9a4e"'),
    "Idempotency-Replayed": ("true if it is the stored response to an earlier request with this key", "true"),
    "Link": ("Where the next page is, as rel=next; missing on the last one", '</api/v1/scans?before=7>; rel="next"'),
    "Location": ("URL of the created resource", "/api/v1/scans/s01jz0000000000000000000000"),
    "Preference-Applied": ("How long it may have waited", "wait=50"),
    "Repr-Digest": (
        "Checksum of the whole file, if Want-Repr-Digest requested it",
        "sha-256=:47DEQpj8HBSa+/TImW+5JA==:",
    ),
    "Retry-After": ("Seconds after which it may be tried again", "1"),
    "Set-Cookie": ("The session's cookie", f"{cookies.NAME}=…; HttpOnly; Path=/api/v1; SameSite=strict"),
    "Tus-Resumable": ("Version of the way in which uploads resume", "1.0.0"),
    "Upload-Length": ("Bytes of the whole file", "1000"),
    "Upload-Offset": ("Bytes of it that have come", "0"),
    "Vary": ("Headers of the request that choose the representation", "Accept"),
    "WWW-Authenticate": ("How to prove oneself", 'Bearer realm="steradian"'),
    "X-Axes": ("Names of the array's axes", "x,y,z"),
    "X-Dtype": ("Type of the values as NumPy writes it", "<f4"),
    "X-Level": ("How many times the values are halved along each axis", "0"),
    "X-Origin": ("Place of the first value along each axis of the answer (m; s along time)", "-0.00678,-0.00678,0"),
    "X-Request-ID": ("Identifier of the request, in the service's log too", "01jz0000000000000000000000"),
    "X-Row": ("Place of the A-line among all of the scan, frame after frame", "612"),
    "X-Scale": ("Pressure unit of one digitiser count", "0.000244"),
    "X-Shape": ("Shape of the array", "226,226,512"),
    "X-Spacing": ("Distance of values along each axis of the answer (m; s along time)", "6e-05,6e-05,1.2e-05"),
    "X-Window": ("Of uint8: the values that are 0 and 255", "0,1.5"),
}
"""Headers of answers, each with an example."""
PUBLISHED_NAMES: Final = {"IterativeOptions": "Iterative"}
"""Names of schemas in the document, by the name of a class that differs from them."""
_HAVE_PROBLEM: Final = frozenset(("HTTPValidationError", "ValidationError"))


def name_operation(route: APIRoute) -> str:
    """Return the operation id of a route: its handler's name, noun first (``read_scan_file``: ``scan_file_read``)."""
    verb, _, noun = route.name.partition("_")
    return f"{noun}_{verb}"


def install_openapi(app: FastAPI) -> None:
    """Replace the application's OpenAPI generator by one that completes the document."""
    plain = app.openapi

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            complete_document(plain())
        below = prefix()
        return plain() | ({"servers": [{"url": below, "description": "This service"}]} if below else {})

    app.openapi = openapi  # type: ignore[method-assign]


def complete_document(document: dict[str, Any]) -> None:
    """Complete the generated document: add operations' errors and headers, remove internal schemas."""
    document |= {"servers": [{"url": "/", "description": "This service"}], "tags": TAGS}
    components = document.setdefault("components", {})
    schemas = components.setdefault("schemas", {})
    own = Problem.model_json_schema(ref_template="#/components/schemas/{model}")
    schemas |= own.pop("$defs", {}) | {"Problem": own}
    for name in _HAVE_PROBLEM:
        schemas.pop(name, None)
    components["securitySchemes"] = SECURITY
    components["headers"] = {
        name: {"description": text, "schema": {"type": "string"}, "example": example}
        for name, (text, example) in RESPONSE_HEADERS.items()
    }
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            _complete_operation(path, method, operation)
    add_links(document)
    for name, published in PUBLISHED_NAMES.items():
        schemas[published] = schemas.pop(name) | {"title": published}
    renamed = {f"#/components/schemas/{name}": published for name, published in PUBLISHED_NAMES.items()}
    for part in list(_dictionaries(document)):
        if (reference := part.get("$ref")) in renamed:
            part["$ref"] = f"#/components/schemas/{renamed[reference]}"
        _tidy_schema(part, schemas)


def _complete_operation(path: str, method: str, operation: dict[str, Any]) -> None:
    name, answers = operation["operationId"], operation["responses"]
    sent = {parameter["name"] for parameter in operation.get("parameters", ())}
    for parameter in operation.get("parameters", ()):
        _take_null_out(parameter["schema"])
    guarded = any(path == root or path.startswith(f"{root}/") for root in SCOPED_ROUTES)
    ways: list[dict[str, list[str]]] = [{}, {"key": []}, {"session": []}] if guarded else []
    operation["security"] = [*ways, {"stop-ticket": []}] if name in BY_STOP_TICKET else ways
    if "If-None-Match" in sent:
        answers["304"] = {"description": "The one you have is still right"}
    if "Range" in sent:
        answers["206"] = {"description": "A range of it", "content": answers["200"]["content"]}
    for status in [status for status in answers if status[0] == "4"]:
        del answers[status]
    for status in _refusals(operation, guarded=guarded):
        answers.setdefault(status, dict(RESPONSES[status]))
    operation["responses"] = {status: answers[status] for status in sorted(answers)}
    for status, answer in operation["responses"].items():
        for header in _headers(operation, method, status, sent):
            answer.setdefault("headers", {})[header] = {"$ref": f"#/components/headers/{header}"}


def _refusals(operation: dict[str, Any], *, guarded: bool) -> set[str]:
    """Return the status codes of an operation's error responses."""
    name, found = operation["operationId"], {"5XX"}
    parameters, body = operation.get("parameters", []), operation.get("requestBody", {}).get("content", {})
    sent, places = {parameter["name"] for parameter in parameters}, {parameter["in"] for parameter in parameters}
    if guarded:
        found |= {"401", "403", "422", "429"}
    if places & {"path", "query"} or name in OPERATION_NAMES or name == "job_create":
        found.add("404")
    if body:
        found |= {"400", "413", "415"} if "application/json" in body else {"400", "413"}
    if "Range" in sent:
        found |= {"400", "416"}
    if "If-Match" in sent:
        found.add("412")
    if len(operation["responses"].get("200", {}).get("content", {})) > 1:
        found.add("406")
    if name in CONFLICT_CODES:
        found.add("409")
    return found


def _headers(operation: dict[str, Any], method: str, status: str, sent: set[str]) -> Iterator[str]:
    """Yield the names of the headers that an operation's response with a status may have."""
    yield from ("Cache-Control", "X-Request-ID")
    if status[0] in "45":
        yield from {"401": ["WWW-Authenticate"], "409": ["Retry-After"], "429": ["Retry-After"]}.get(status, [])
        yield from ["Retry-After"] if status == "5XX" else ["Content-Range"] if status == "416" else []
        return
    content = operation["responses"][status].get("content", {})
    if sent & {"If-Match", "If-None-Match"}:
        yield "ETag"
    if operation["operationId"] in ("session_create", "session_delete"):
        yield "Set-Cookie"
    if "Prefer" in sent:
        yield "Preference-Applied"
    if "Idempotency-Key" in sent:
        yield "Idempotency-Replayed"
    if method == "post" and operation["operationId"].endswith("_create"):
        yield "Location"
    if operation["operationId"] in ("upload_append", "upload_create", "upload_read"):
        yield from ("Tus-Resumable", "Upload-Length", "Upload-Offset")
    if operation["operationId"] == "upload_append":
        yield "Repr-Digest"
    if "before" in sent:
        yield "Link"
    if "Range" in sent:
        yield from ("Accept-Ranges", "Content-Range") if status == "206" else ("Accept-Ranges",)
        yield from () if status == "304" else ("Repr-Digest",)
    if len(content) > 1:
        yield "Vary"
    if {NPY, RAW} <= set(content):
        yield from ("X-Axes", "X-Dtype", "X-Shape")
    if operation["operationId"] == "scan_latest_aline_read":
        yield from ("X-Origin", "X-Row", "X-Scale", "X-Spacing")
    if "max_size" in sent:
        yield from ("X-Level", "X-Origin", "X-Spacing", "X-Window")


def _take_null_out(schema: dict[str, Any]) -> None:
    """Remove null from the schema of an optional parameter, because headers and queries cannot be null."""
    if {"type": "null"} in schema.get("anyOf", ()):
        schema["anyOf"].remove({"type": "null"})
        if len(schema["anyOf"]) == 1:
            schema |= schema.pop("anyOf")[0]


def _tidy_schema(part: dict[str, Any], schemas: dict[str, Any]) -> None:
    """Simplify a schema: units as an extension, tuples as lists, discriminator tags required."""
    if isinstance(part.get("unit"), str):
        part["x-unit"] = part.pop("unit")
    if "prefixItems" in part:
        parts = part.pop("prefixItems")
        kinds = [one for place, one in enumerate(parts) if one not in parts[:place]]
        part["items"] = kinds[0] if len(kinds) == 1 else {"anyOf": kinds}
    told = part.get("discriminator")
    if isinstance(told, dict) and "mapping" in told:
        for reference in told["mapping"].values():
            member = schemas[reference.rpartition("/")[2]]
            member["required"] = sorted({*member.get("required", ()), told["propertyName"]})


def _dictionaries(part: Any) -> Iterator[dict[str, Any]]:
    if isinstance(part, dict):
        yield part
        for value in part.values():
            yield from _dictionaries(value)
    elif isinstance(part, list):
        for value in part:
            yield from _dictionaries(value)
