"""Middleware for light GETs: identical concurrent requests share one execution.

Responses are reused while their validator is unchanged.

A look that has begun is joined by nobody, as it may be older than what the next client has just been told: who comes
while one is under way shares the next. An answer is kept with the stamp that its thing had before it was made, and is
given again while the stamp, looked at anew for each request, is that one. So every answer is as fresh as if it had been
made for its client alone, and a scan's coverage as fresh as its progress.
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
    """Shares the answers of light reads.

    Parameters
    ----------
    stamp
        Tells the stamp of what a request asks for: empty where answers to it cannot be kept.
    """

    def __init__(self, app: ASGIApp, stamp: Callable[[Scope], Awaitable[Validator]]) -> None:
        self.app, self._stamp = app, stamp
        self._under_way: dict[Hashable, asyncio.Task[_CachedResponse]] = {}
        self._next: dict[Hashable, asyncio.Task[_CachedResponse]] = {}
        self._kept = _ResponseCache()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve."""
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
        """Run the request independently of the connection of the first client."""
        own, sent = dict(scope), list[Message]()

        async def receive() -> Message:
            return {"type": "http.request", "body": b"", "more_body": False}

        async def send(message: Message) -> None:
            sent.append(message)

        await self.app(own, receive, send)
        return _CachedResponse(sent[0], b"".join(part.get("body", b"") for part in sent[1:]), own.get("route"))


class _ResponseCache:
    """Response cache by request key, of at most :data:`MAX_BYTES` bytes; the least recently used are evicted."""

    def __init__(self) -> None:
        self._answers: OrderedDict[Hashable, tuple[Validator, _CachedResponse]] = OrderedDict()
        self._bytes = 0

    def get(self, key: Hashable, stamp: Validator) -> _CachedResponse | None:
        """Return the answer that was made at a stamp."""
        kept, answer = self._answers.get(key, ((), None))
        if answer is None or kept != stamp:
            return None
        self._answers.move_to_end(key)
        return answer

    def put(self, key: Hashable, stamp: Validator, answer: _CachedResponse) -> None:
        """Keep an answer that was begun after its stamp was looked at."""
        if not stamp or answer.start["status"] >= 400 or len(answer.body) > MAX_ENTRY_BYTES:
            return
        _, before = self._answers.pop(key, (stamp, None))
        self._bytes += len(answer.body) - (0 if before is None else len(before.body))
        self._answers[key] = stamp, answer
        while self._bytes > MAX_BYTES or len(self._answers) > MAX_ENTRIES:
            _, (_, oldest) = self._answers.popitem(last=False)
            self._bytes -= len(oldest.body)


def _key(scope: Scope) -> Hashable:
    """Return the key of a request, with everything its response depends on; ``None`` if it cannot be shared."""
    if scope["type"] != "http" or scope["method"] != "GET" or not _COALESCED_PATHS.fullmatch(scope["path"]):
        return None
    headers = Headers(scope=scope)
    if any(name in headers for name in _BYPASS_HEADERS):
        return None
    principal = scope["state"].get("principal")
    return prefix(), scope["path"], scope["query_string"], principal, *(headers.get(name) for name in _VARY_HEADERS)
