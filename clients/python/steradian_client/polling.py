"""Waiting for the end of a scan or job, by events with polling as fallback."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from contextlib import aclosing
from typing import Final, Generic, TypeVar

from steradian_client.errors import JobFailed, ServiceError
from steradian_client.events import follow
from steradian_client.models import Batch, Event, LongRunning
from steradian_client.request_session import RequestSession

Report = Callable[[str, int, int], None]
"""Called as ``progress(stage, done, total)`` while waiting."""

POLL_INTERVAL: Final = 1.0
"""Seconds for which the service holds an answer, where there is no stream."""
MAX_EVENT_WAIT: Final = 30.0
"""Seconds after which one looks although nothing was heard."""
FINAL_POLLS: Final = 20.0
"""Seconds before the end of a limited wait from which on is asked, as a stream may be silent for 15 s."""


Kind = TypeVar("Kind", bound=LongRunning | Batch)


class CompletionWaiter(Generic[Kind]):
    """Wait for the end of one scan, reconstruction, job or batch.

    Parameters
    ----------
    kind
        What events about it are called; ``None``: it may be any kind.
    look
        Reads it; the service may hold the answer for so many seconds.
    report
        Told of every advance.
    timeout
        Seconds; ``None`` waits as long as it takes.
    """

    def __init__(
        self,
        session: RequestSession,
        kind: str | None,
        look: Callable[[float], Awaitable[Kind]],
        report: Report | None,
        timeout: float | None,
    ) -> None:
        self._session, self._kind, self._look_at, self._report = session, kind, look, report
        self._deadline = None if timeout is None else time.monotonic() + timeout
        self._has_stream, self._said = True, ("", 0, 0)

    async def wait(self, work: Kind) -> Kind:
        """Wait until the resource has ended, and return its final state.

        Raises
        ------
        JobFailed
            When it did not end well.
        TimeoutError
            When it is not over in time; it goes on.
        """
        self._tell(work.progress.stage, work.progress.done, work.progress.total)
        while not work.is_over:
            left = self._left()
            if left <= 0:
                raise TimeoutError(f"{work.id} is still {work.state}")
            if self._has_stream and left > FINAL_POLLS:
                work = await self._by_events(work)
            else:
                work = await self._ask(min(POLL_INTERVAL, left))
        if not work.succeeded:
            raise JobFailed(work.id, work.state, work.error.detail if work.error else None)
        return work

    async def _ask(self, seconds: float) -> Kind:
        """Poll the resource once, and return its state after ``seconds`` unless it ends before."""
        begun = time.monotonic()
        work = await self._look(max(1.0, seconds))
        if not work.is_over and (rest := begun + seconds - time.monotonic()) > 0:
            await self._session.transport.sleep(rest)
        return work

    async def _by_events(self, work: Kind) -> Kind:
        looked = float("-inf")
        try:
            async with aclosing(follow(self._session, {"kind": self._kind}, None)) as events:
                async for event in events:
                    if self._concerns(work, event) or time.monotonic() - looked > MAX_EVENT_WAIT:
                        looked, work = time.monotonic(), await self._look(0.0)
                    if work.is_over or self._left() <= FINAL_POLLS:
                        return work
        except ServiceError:
            self._has_stream = False
        return work

    def _concerns(self, work: Kind, event: Event | None) -> bool:
        """Return whether an event is a reason to poll, and report progress events."""
        if event is None or event.kind in {"ready", "reset"}:
            return event is not None
        if event.subject != work.id:
            return False
        if event.kind == "progress":
            told, done = event.data.get("stage"), event.data.get("done", 0)
            if told != self._said[0] or done > self._said[1]:  # what has just been looked at may be newer
                self._tell(told, done, event.data.get("total", 0))
        return event.kind != "progress"

    async def _look(self, hold: float) -> Kind:
        work = await self._look_at(hold)
        self._tell(work.progress.stage, work.progress.done, work.progress.total)
        return work

    def _tell(self, stage: str | None, done: int, total: int) -> None:
        if self._report is not None and stage is not None and self._said != (stage, done, total):
            self._said = (stage, done, total)
            self._report(stage, done, total)

    def _left(self) -> float:
        return float("inf") if self._deadline is None else self._deadline - time.monotonic()
