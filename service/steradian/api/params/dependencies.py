"""FastAPI dependencies of route handlers: services, caller, long polling, idempotency keys and paging."""

from __future__ import annotations

import asyncio
import hashlib
import json
import re
from collections.abc import Callable, Iterator
from contextlib import aclosing, contextmanager, suppress
from dataclasses import replace
from typing import Annotated, Any, Final, Protocol, TypeAlias, TypeVar
from urllib.parse import urlencode

from fastapi import Depends, Header, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from steradian.api.http.proxy_detection import is_forwarded
from steradian.api.http.urls import BASE, address, prefix
from steradian.api.services import ServiceContainer
from steradian.api.streaming.broadcaster import EventBroadcaster
from steradian.core.exceptions import InvalidInput, NotFound
from steradian.security.keys import Principal
from steradian.storage.repositories.idempotency import IdempotencyKey, StoredResponse

MAX_WAIT, MAX_WAIT_FORWARDED = 120.0, 50.0
"""Longest that a request is held (s), and one that came through a proxy, which gives up after 60 s; it asks again."""
_WAIT_HELP = (
    f"'wait=SECONDS' (RFC 7240) holds the answer until the work is over, {MAX_WAIT:g} s at most and"
    f" {MAX_WAIT_FORWARDED:g} s through a proxy: see Preference-Applied"
)

MAX_KEY: Final = 200
_KEY: Final = re.compile(r"^[\x21-\x7e]+$")

T = TypeVar("T")


async def _services(request: Request) -> ServiceContainer:
    services: ServiceContainer = request.app.state.services
    return services


async def _who(request: Request) -> Principal:
    principal: Principal = request.state.principal
    return principal


def longest_wait(request: Request) -> float:
    """Return the longest time for which a response may be delayed, in s; shorter through a proxy."""
    return MAX_WAIT_FORWARDED if is_forwarded(request.scope) else MAX_WAIT


class LongPoll:
    """Long-poll helper: delay a response until a condition holds, the wait expires or the client disconnects."""

    def __init__(self, request: Request, seconds: float) -> None:
        self._request, self.seconds = request, seconds
        self._feed: EventBroadcaster = request.app.state.feed

    async def wait_for(self, look: Callable[[], T], is_over: Callable[[T], bool]) -> T:
        """Poll ``look`` in a thread until ``is_over`` holds, the wait has expired or the client has disconnected.

        It polls when the event log has grown, which one task watches for all requests, and at regular intervals.
        """
        seen = await run_in_threadpool(look)
        if self.seconds:
            self._request.state.preference_applied = f"wait={self.seconds:g}"
        if not self.seconds or is_over(seen):
            return seen
        with suppress(TimeoutError):
            async with asyncio.timeout(self.seconds), aclosing(self._feed.subscribe(progress=False)) as changes:
                async for _ in changes:
                    seen = await run_in_threadpool(look)
                    if is_over(seen) or await self._request.is_disconnected():
                        return seen
        return await run_in_threadpool(look)


async def _wait(
    request: Request,
    prefer: Annotated[str | None, Header(alias="Prefer", description=_WAIT_HELP)] = None,
) -> LongPoll:
    # It may come in several lines, but is declared as one text: common generators know no other headers.
    for preference in ",".join(request.headers.getlist("prefer")).split(","):
        found = re.fullmatch(r"\s*wait\s*=\s*\"?([0-9]{1,9})\"?\s*", preference)
        if found:
            return LongPoll(request, min(float(found[1]), longest_wait(request)))
    return LongPoll(request, 0.0)


def _key_header(what: str) -> Any:
    """Declare the Idempotency-Key header; :func:`_read_key` checks its limits, so that its errors are readable."""
    limits: dict[str, Any] = {"minLength": 1, "maxLength": MAX_KEY, "pattern": _KEY.pattern}
    return Header(alias="Idempotency-Key", description=what, json_schema_extra=limits, examples=["phantom-7"])


async def _key(
    request: Request,
    idempotency_key: Annotated[
        str | None,
        _key_header("Idempotency key: a repeated request with it is executed once and receives the first response"),
    ] = None,
) -> IdempotencyKey | None:
    return None if idempotency_key is None else await _read_key(request, idempotency_key)


async def _required_key(
    request: Request,
    idempotency_key: Annotated[
        str, _key_header("Any text of your own, new for each scan: a repeated request never fires twice")
    ],
) -> IdempotencyKey:
    return await _read_key(request, idempotency_key)


async def _read_key(request: Request, text: str) -> IdempotencyKey:
    if not _KEY.fullmatch(text) or len(text) > MAX_KEY:
        raise InvalidInput("Idempotency-Key", text, f"1 to {MAX_KEY} visible ASCII characters")
    digest = hashlib.sha256(await request.body()).hexdigest()
    return IdempotencyKey(request.state.principal.name, request.url.path, text, digest)


ServicesDep: TypeAlias = Annotated[ServiceContainer, Depends(_services)]
CurrentPrincipal: TypeAlias = Annotated[Principal, Depends(_who)]
"""Who asks, as proved to :class:`steradian.api.middleware.authentication.AuthenticationMiddleware`."""
Wait: TypeAlias = Annotated[LongPoll, Depends(_wait)]
"""How long the client is ready to wait; not at all when it did not say."""
OptionalIdempotencyKey: TypeAlias = Annotated[IdempotencyKey | None, Depends(_key)]
RequiredIdempotencyKey: TypeAlias = Annotated[IdempotencyKey, Depends(_required_key)]
Limit: TypeAlias = Annotated[int, Query(ge=1, le=1000, description="Most items of the answer", examples=[100])]
PageCursor: TypeAlias = Annotated[
    int | None, Query(ge=0, le=2**31 - 1, description="Cursor of the Link header's next page", examples=[17])
]


def set_next_link(response: Response, request: Request, limit: int, cursor: int | None) -> None:
    """Add the ``Link: rel="next"`` header for the next page, with the same filters."""
    if cursor is not None:
        chosen = [pair for pair in request.query_params.multi_items() if pair[0] not in {"limit", "before"}]
        query = urlencode([("limit", limit), ("before", cursor), *chosen])
        response.headers["Link"] = f'<{address(request.url.path)}?{query}>; rel="next"'


@contextmanager
def deleted_since(answer: StoredResponse) -> Iterator[None]:
    """Suppress :class:`NotFound` for a repeated request whose resource has been deleted since the first one."""
    try:
        yield
    except NotFound:
        if not answer.replayed:
            raise


def idempotent_response(answer: StoredResponse) -> Response:
    """Build the HTTP response from a stored (or newly stored) response to an idempotent request."""
    before = answer.location.rpartition(f"{BASE}/")[0]  # below which path it was asked first
    location, body = answer.location, answer.body
    if answer.replayed and before != prefix():
        shown = json.loads(body)
        shown["links"] = {name: address(at.removeprefix(before)) for name, at in shown["links"].items()}
        location, body = address(location.removeprefix(before)), json.dumps(shown, ensure_ascii=False)
    headers = {"Location": location} | ({"Idempotency-Replayed": "true"} if answer.replayed else {})
    return Response(body, answer.status, headers, media_type="application/json")


class Linked(Protocol):
    """Protocol of resource views with links."""

    links: dict[str, str]

    def model_dump_json(self) -> str:
        """Return the response model of the resource as JSON text."""


async def final_response(
    answer: StoredResponse, wait: LongPoll, read: Callable[[str], tuple[Linked, bool]]
) -> Response:
    """Return the stored response or, if the client waits, the resource's state at its end or at the end of the wait.

    ``read`` returns the view of the resource with an identifier, and whether it has ended: then a 202 becomes a 201.
    """
    if not wait.seconds:
        return idempotent_response(answer)
    identifier = answer.location.rpartition("/")[2]
    with deleted_since(answer):
        view, is_over = await wait.wait_for(lambda: read(identifier), lambda seen: seen[1])
        status = 201 if is_over else answer.status
        answer = replace(answer, status=status, location=view.links["self"], body=view.model_dump_json())
    return idempotent_response(answer)
