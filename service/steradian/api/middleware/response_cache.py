"""Request coalescing and response cache for light GET requests.

Identical concurrent requests share one execution. Responses are reused while their validator is unchanged.

A request does not join an execution that has already begun, because the result may be older than a response that its
client has just received: requests that arrive during an execution share the next one. A response is cached with the
validator that its resource had before the execution, and is reused while the validator, which is queried for each
request, is the same. So every response is as fresh as if it had been computed for its client alone, and a scan's
coverage is as fresh as its progress.
"""

from __future__ import annotations

import asyncio
import re
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Hashable
from dataclasses import dataclass
from typing import Final

from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from steradian.api.errors.handlers import DATABASE_ERRORS, database_problem
from steradian.api.http.urls import prefix
from steradian.storage.repositories.validators import Validator

_COALESCED_PATHS: Final = re.compile(
    r"/api/v1/(?:(?:masks|plans|scans|reconstructions|jobs|batches|scanners)(?:/[a-z0-9-]+)?|scans/[a-z0-9]+/coverage)"
)
"""Small JSON that is read again and again, and is the same for all who may read it."""
_BYPASS_HEADERS: Final = ("prefer", "range")
"""Headers that make a request its client's alone."""
_VARY_HEADERS: Final = ("accept", "if-none-match", "if-match")
"""Headers on which the answer depends."""
MAX_BYTES, MAX_ENTRY_BYTES, MAX_ENTRIES = 16 * 2**20, 2**20, 2000
"""Bytes of all answers that are kept, and of each; and how many."""


@dataclass(frozen=True)
class _CachedResponse:
    start: Message
    body: bytes
    route: object


class CoalescingCacheMiddleware:
    """ASGI middleware for light GET requests: request coalescing, and a response cache checked by validators.

    Parameters
    ----------
    stamp
        Function that returns the validator of the requested resource: empty if responses cannot be cached.
    """

    def __init__(self, app: ASGIApp, stamp: Callable[[Scope], Awaitable[Validator]]) -> None:
        self.app, self._stamp = app, stamp
        self._under_way: dict[Hashable, asyncio.Task[_CachedResponse]] = {}
        self._next: dict[Hashable, asyncio.Task[_CachedResponse]] = {}
        self._kept = _ResponseCache()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a light GET request from the cache or a shared execution; pass other requests on."""
        key = _key(scope)
        if key is None:
            return await self.app(scope, receive, send)
        try:
            stamp = await self._stamp(scope)
        except DATABASE_ERRORS as error:
            return await (await database_problem(Request(scope), error))(scope, receive, send)
        answer = self._kept.get(key, stamp)
        if answer is None:
            is_first = key not in self._under_way
            answer = await asyncio.shield(self._start(key, scope) if is_first else self._queue_next(key, scope))
            if answer.start["status"] >= 400 and not is_first:  # a problem names its own request
                return await self.app(scope, receive, send)
            self._kept.put(key, stamp, answer)
        scope["route"] = answer.route
        await send({**answer.start, "headers": list(answer.start["headers"])})
        return await send({"type": "http.response.body", "body": answer.body})

    def _start(self, key: Hashable, scope: Scope) -> asyncio.Task[_CachedResponse]:
        task = self._under_way[key] = asyncio.create_task(self._execute(scope))
        task.add_done_callback(lambda done: self._discard(key, done))
        return task

    def _queue_next(self, key: Hashable, scope: Scope) -> asyncio.Task[_CachedResponse]:
        if key not in self._next:
            self._next[key] = asyncio.create_task(self._run_after(self._under_way[key], key, scope))
        return self._next[key]

    async def _run_after(self, before: asyncio.Task[_CachedResponse], key: Hashable, scope: Scope) -> _CachedResponse:
        await asyncio.wait({before})
        task = self._under_way[key] = self._next.pop(key)
        task.add_done_callback(lambda done: self._discard(key, done))
        return await self._execute(scope)

    def _discard(self, key: Hashable, task: asyncio.Task[_CachedResponse]) -> None:
        if self._under_way.get(key) is task:
            del self._under_way[key]

    async def _execute(self, scope: Scope) -> _CachedResponse:
        """Execute the request independently of the first client's connection, and return the buffered response."""
        own, sent = dict(scope), list[Message]()

        async def receive() -> Message:
            return {"type": "http.request", "body": b"", "more_body": False}

        async def send(message: Message) -> None:
            sent.append(message)

        await self.app(own, receive, send)
        return _CachedResponse(sent[0], b"".join(part.get("body", b"") for part in sent[1:]), own.get("route"))


class _ResponseCache:
    """LRU cache of responses by request key, of at most :data:`MAX_BYTES` bytes."""

    def __init__(self) -> None:
        self._answers: OrderedDict[Hashable, tuple[Validator, _CachedResponse]] = OrderedDict()
        self._bytes = 0

    def get(self, key: Hashable, stamp: Validator) -> _CachedResponse | None:
        """Return the cached response of a key if its validator is ``stamp``; otherwise ``None``."""
        kept, answer = self._answers.get(key, ((), None))
        if answer is None or kept != stamp:
            return None
        self._answers.move_to_end(key)
        return answer

    def put(self, key: Hashable, stamp: Validator, answer: _CachedResponse) -> None:
        """Cache a response with the validator that was read before its execution."""
        if not stamp or answer.start["status"] >= 400 or len(answer.body) > MAX_ENTRY_BYTES:
            return
        _, before = self._answers.pop(key, (stamp, None))
        self._bytes += len(answer.body) - (0 if before is None else len(before.body))
        self._answers[key] = stamp, answer
        while self._bytes > MAX_BYTES or len(self._answers) > MAX_ENTRIES:
            _, (_, oldest) = self._answers.popitem(last=False)
            self._bytes -= len(oldest.body)


def _key(scope: Scope) -> Hashable:
    """Return the cache key of a request, from all inputs of its response; ``None`` if the response cannot be shared."""
    if scope["type"] != "http" or scope["method"] != "GET" or not _COALESCED_PATHS.fullmatch(scope["path"]):
        return None
    headers = Headers(scope=scope)
    if any(name in headers for name in _BYPASS_HEADERS):
        return None
    principal = scope["state"].get("principal")
    return prefix(), scope["path"], scope["query_string"], principal, *(headers.get(name) for name in _VARY_HEADERS)
