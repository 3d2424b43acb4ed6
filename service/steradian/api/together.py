"""Those who ask for the same thing in the same moment are answered by one look at it.

A look that has begun is joined by nobody, as it may be older than what the next client has just been told: who comes
while one is under way shares the next. So every answer is as fresh as if it had been made for its client alone.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Final

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_SHARED: Final = re.compile(
    r"/api/v1/(?:(?:masks|plans|scans|reconstructions|jobs|batches|scanners)(?:/[a-z0-9-]+)?|scans/[a-z0-9]+/coverage)"
)
"""Small JSON that is read again and again, and is the same for all who may read it."""
_OWN: Final = ("prefer", "range")
"""Headers that make a request its client's alone."""
_SAME: Final = ("accept", "if-none-match", "if-match")
"""Headers on which the answer depends."""


@dataclass(frozen=True)
class _Answer:
    start: Message
    body: bytes
    route: object


class Together:
    """Shares the answers of light reads."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app
        self._under_way: dict[Hashable, asyncio.Task[_Answer]] = {}
        self._next: dict[Hashable, asyncio.Task[_Answer]] = {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve."""
        key = _key(scope)
        if key is None:
            return await self.app(scope, receive, send)
        is_first = key not in self._under_way
        answer = await asyncio.shield(self._begin(key, scope) if is_first else self._join(key, scope))
        if answer.start["status"] >= 400 and not is_first:  # a problem names its own request
            return await self.app(scope, receive, send)
        scope["route"] = answer.route
        await send({**answer.start, "headers": list(answer.start["headers"])})
        return await send({"type": "http.response.body", "body": answer.body})

    def _begin(self, key: Hashable, scope: Scope) -> asyncio.Task[_Answer]:
        task = self._under_way[key] = asyncio.create_task(self._look(scope))
        task.add_done_callback(lambda done: self._forget(key, done))
        return task

    def _join(self, key: Hashable, scope: Scope) -> asyncio.Task[_Answer]:
        if key not in self._next:
            self._next[key] = asyncio.create_task(self._look_after(self._under_way[key], key, scope))
        return self._next[key]

    async def _look_after(self, before: asyncio.Task[_Answer], key: Hashable, scope: Scope) -> _Answer:
        await asyncio.wait({before})
        task = self._under_way[key] = self._next.pop(key)
        task.add_done_callback(lambda done: self._forget(key, done))
        return await self._look(scope)

    def _forget(self, key: Hashable, task: asyncio.Task[_Answer]) -> None:
        if self._under_way.get(key) is task:
            del self._under_way[key]

    async def _look(self, scope: Scope) -> _Answer:
        """Have the answer made, without the connection of the client who came first."""
        own, sent = dict(scope), list[Message]()

        async def receive() -> Message:
            return {"type": "http.request", "body": b"", "more_body": False}

        async def send(message: Message) -> None:
            sent.append(message)

        await self.app(own, receive, send)
        return _Answer(sent[0], b"".join(part.get("body", b"") for part in sent[1:]), own.get("route"))


def _key(scope: Scope) -> Hashable:
    """Tell what is asked for, with all that the answer depends on; ``None`` where it cannot be shared."""
    if scope["type"] != "http" or scope["method"] != "GET" or not _SHARED.fullmatch(scope["path"]):
        return None
    headers = Headers(scope=scope)
    if any(name in headers for name in _OWN):
        return None
    principal = scope["state"].get("principal")
    return scope["path"], scope["query_string"], principal, *(headers.get(name) for name in _SAME)
