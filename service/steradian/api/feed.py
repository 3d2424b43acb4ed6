"""What happens, for many listeners: one look at the database for all of them, and a cursor each.

A listener that reads slowly costs nothing but its own time: what it has not read stays in the log.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from collections.abc import AsyncGenerator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from sqlalchemy.exc import DBAPIError
from starlette.concurrency import run_in_threadpool

from steradian.api.services import Services
from steradian.jobs.kinds import resource_of
from steradian.storage.tables import EventRow

LOOK = 0.1
"""Seconds between looks at the log."""
PROGRESS = 0.2
"""Seconds between looks at progress: at most five a second."""
ANYWAY = 2.0
"""Seconds after which a listener looks around even when nothing is known to have changed."""
KEPT = 1000
"""Newest events that are kept in memory for all listeners."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Progress:
    """How far a scan or reconstruction is; ``eta`` in seconds while it can be told."""

    kind: str
    id: str
    scan_id: str | None
    stage: str | None
    done: int
    total: int
    eta: float | None


class Feed:
    """Looks at the database while anybody listens."""

    def __init__(self, services: Services) -> None:
        self._services = services
        self._moved, self._changed = asyncio.Event(), asyncio.Event()
        """Set, and replaced, when there is something new at all, and when an event is."""
        self._task: asyncio.Task[None] | None = None
        self._listeners = self._watchers = 0
        """Who listens at all, and who wants progress too."""
        self._events: deque[EventRow] = deque(maxlen=KEPT)
        self._since = self.last = 0
        self.progress: dict[str, Progress] = {}
        self._stages: dict[str, tuple[str | None, float, int]] = {}

    async def listen(self, *, progress: bool = True) -> AsyncGenerator[None, None]:
        """Yield whenever there may be an event or, unless that does not matter, progress, and now and then anyway."""
        self._listeners += 1
        self._watchers += progress
        if self._task is None:
            self._task = asyncio.create_task(self._look())
        try:
            while True:
                changed = self._moved if progress else self._changed
                yield
                with suppress(TimeoutError):
                    await asyncio.wait_for(changed.wait(), ANYWAY)
        finally:
            self._listeners -= 1
            self._watchers -= progress
            if not self._listeners and self._task is not None:
                self._task.cancel()
                self._task = None
                self.progress = {}  # the next listener would be told of it as if it were new

    def after(self, sequence: int) -> list[EventRow] | None:
        """Return the events after a number, oldest first; ``None`` when they are not all in memory."""
        if not self._since <= sequence <= self.last:
            return None
        return [event for event in self._events if event.sequence > sequence]

    async def _look(self) -> None:
        looked = float("-inf")
        self._events.clear()
        self._since, self.last = 0, -1
        while True:
            try:
                if is_first := self.last < 0:
                    self._since = self.last = (await run_in_threadpool(self._services.log.bounds)).last
                news = await run_in_threadpool(self._services.log.after, self.last, KEPT)
                before = self.progress
                if self._watchers and time.monotonic() - looked >= PROGRESS:
                    looked = time.monotonic()
                    self.progress = await run_in_threadpool(self._find_progress)
                self._take(news)
                if news or is_first:
                    self._changed.set()
                    self._changed = asyncio.Event()
                if news or is_first or self.progress != before:
                    self._moved.set()
                    self._moved = asyncio.Event()
            except DBAPIError as error:
                _log.warning("the log cannot be read: %s", error.orig)
            await asyncio.sleep(LOOK)

    def _take(self, news: list[EventRow]) -> None:
        for event in news:
            if len(self._events) == KEPT:
                self._since = self._events[0].sequence
            self._events.append(event)
            self.last = event.sequence

    def _find_progress(self) -> dict[str, Progress]:
        rows: list[tuple[str, Any, str | None]] = [("scan", row, row.id) for row in self._services.scans.under_way()]
        rows += [(resource_of(row.kind), row, row.scan_id) for row in self._services.ledger.unfinished()]
        found = {}
        for kind, row, scan_id in rows:
            if row.stage is not None:
                eta = self._eta(row.id, row.stage, row.done, row.total)
                found[row.id] = Progress(kind, row.id, scan_id, row.stage, row.done, row.total, eta)
        self._stages = {identifier: seen for identifier, seen in self._stages.items() if identifier in found}
        return found

    def _eta(self, identifier: str, stage: str | None, done: int, total: int) -> float | None:
        """Extrapolate a stage from when and where it was first seen."""
        now = time.monotonic()
        seen = self._stages.get(identifier)
        if seen is None or seen[0] != stage or done < seen[2]:
            seen = self._stages[identifier] = (stage, now, done)
        advance = done - seen[2]
        return round((total - done) * (now - seen[1]) / advance, 1) if advance > 0 and now > seen[1] else None
