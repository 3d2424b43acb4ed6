"""Event broadcaster: one poller of the event log serves all subscribers.

A slow subscriber does not delay the others: events that it has not read stay in the log.
"""

from __future__ import annotations

import asyncio
import json
import logging
import time
from collections import deque
from collections.abc import AsyncGenerator, Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

from fastapi.sse import format_sse_event
from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool

from steradian.api.background.batcher import BatchLoader
from steradian.api.services import ServiceContainer
from steradian.storage.db.tables import EventRow
from steradian.storage.repositories.event_log import LogBounds

POLL_INTERVAL = 0.1
"""Seconds between looks at the log."""
PROGRESS_INTERVAL = 0.2
"""Seconds between looks at progress: at most five a second."""
MAX_WAIT = 2.0
"""Seconds after which a listener looks around even when nothing is known to have changed."""
BUFFER_SIZE = 1000
"""Newest events that are kept in memory for all listeners."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Progress:
    """Progress of a scan or reconstruction; ``eta`` in seconds, or None if it cannot be estimated."""

    kind: str
    id: str
    scan_id: str | None
    stage: str | None
    done: int
    total: int
    eta: float | None

    @cached_property
    def sse_frame(self) -> bytes:
        """Server-sent event of this progress, encoded once for all streams."""
        return format_sse_event(event="progress", data_str=json.dumps(asdict(self)))


class Event:
    """Event of the event log, encoded once as a server-sent event."""

    def __init__(self, row: EventRow, epoch: str) -> None:
        self.sequence, self.kind, self.scan_id = row.sequence, row.kind, row.scan_id
        data = {"id": row.resource_id, "at": row.at.isoformat(), **row.data}
        self.frame = format_sse_event(event=row.kind, id=f"{epoch}.{row.sequence}", data_str=json.dumps(data))


class EventBroadcaster:
    """Broadcaster that polls the event log while there are subscribers, and wakes them."""

    def __init__(self, services: ServiceContainer) -> None:
        self._services = services
        self._moved, self._changed = asyncio.Event(), asyncio.Event()
        """Set, and replaced, when there is something new at all, and when an event is."""
        self._task: asyncio.Task[None] | None = None
        self._listeners = self._watchers = 0
        """Who listens at all, and who wants progress too."""
        self._joined = False
        """Whether somebody began to listen since progress was last looked for."""
        self._events: deque[Event] = deque(maxlen=BUFFER_SIZE)
        self._bounds: BatchLoader[None, LogBounds] = BatchLoader(lambda _: {None: services.log.bounds()})
        self._since = self.last = 0
        self._progress: dict[str, Progress] = {}
        self._looked = float("-inf")
        """When progress was last looked for, by the monotonic clock."""
        self._stages: dict[str, tuple[str | None, float, int]] = {}

    async def subscribe(self, *, progress: bool = True) -> AsyncGenerator[None, None]:
        """Yield when there may be new events or, optionally, new progress, and at regular intervals."""
        self._listeners += 1
        self._watchers += progress
        self._joined |= progress
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._look())
        try:
            while True:
                changed = self._moved if progress else self._changed
                yield
                # Python 3.11's wait_for loses a cancellation that comes in the same moment as the change.
                with suppress(TimeoutError):
                    async with asyncio.timeout(MAX_WAIT):
                        await changed.wait()
        finally:
            self._listeners -= 1
            self._watchers -= progress
            if not self._listeners and self._task is not None:
                self._task.cancel()
                self._task = None

    def progress(self, since: float) -> Iterable[Progress]:
        """Return the present progress of all scans and jobs; empty if last polled before ``since``."""
        return self._progress.values() if self._looked >= since else ()

    async def log_bounds(self) -> LogBounds:
        """Return the first and last event number; concurrent callers share one query."""
        return await self._bounds.load(None)

    async def events_after(self, sequence: int, epoch: str, limit: int) -> list[Event]:
        """Return events after an event number, oldest first: from memory, or at most ``limit`` from the log."""
        if not self._since <= sequence <= self.last:
            return [Event(row, epoch) for row in await run_in_threadpool(self._services.log.after, sequence, limit)]
        if sequence == self.last:
            return []
        return [event for event in self._events if event.sequence > sequence]

    async def _look(self) -> None:
        self._events.clear()
        self._since, self.last, epoch = 0, -1, ""
        while True:
            try:
                if is_first := self.last < 0:
                    bounds = await self.log_bounds()
                    self._since = self.last = bounds.last
                    epoch = bounds.epoch
                rows = await run_in_threadpool(self._services.log.after, self.last, BUFFER_SIZE)
                news = [Event(row, epoch) for row in rows]
                before, joined = self._progress, False
                if self._watchers and time.monotonic() - self._looked >= PROGRESS_INTERVAL:
                    looked, joined, self._joined = time.monotonic(), self._joined, False
                    self._progress = await run_in_threadpool(self._find_progress)
                    self._looked = looked
                self._take(news)
                if news or is_first:
                    self._changed.set()
                    self._changed = asyncio.Event()
                if news or is_first or joined or self._progress != before:
                    self._moved.set()
                    self._moved = asyncio.Event()
            except SQLAlchemyError as error:  # a lack of connections is no DBAPIError
                _log.warning("the log cannot be read: %s", getattr(error, "orig", error))
            except Exception:  # those who listen would wait for ever
                _log.exception("the log cannot be parsed")
            await asyncio.sleep(POLL_INTERVAL)

    def _take(self, news: list[Event]) -> None:
        for event in news:
            if len(self._events) == BUFFER_SIZE:
                self._since = self._events[0].sequence
            self._events.append(event)
            self.last = event.sequence

    def _find_progress(self) -> dict[str, Progress]:
        rows: list[tuple[str, Any, str | None]] = [("scan", row, row.id) for row in self._services.scans.under_way()]
        rows += [(row.resource, row, row.scan_id) for row in self._services.ledger.unfinished()]
        found = {}
        for kind, row, scan_id in rows:
            if row.stage is not None:
                eta = self._eta(row.id, row.stage, row.done, row.total)
                found[row.id] = Progress(kind, row.id, scan_id, row.stage, row.done, row.total, eta)
        self._stages = {identifier: seen for identifier, seen in self._stages.items() if identifier in found}
        return found

    def _eta(self, identifier: str, stage: str | None, done: int, total: int) -> float | None:
        """Return the remaining seconds of a stage, extrapolated from its first observation."""
        now = time.monotonic()
        seen = self._stages.get(identifier)
        if seen is None or seen[0] != stage or done < seen[2]:
            seen = self._stages[identifier] = (stage, now, done)
        advance = done - seen[2]
        return round((total - done) * (now - seen[1]) / advance, 1) if advance > 0 and now > seen[1] else None
