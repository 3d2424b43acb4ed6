"""Adaptive polling of the queue: fast after a job, slow while one runs, else on database changes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Final

from steradian.jobs.worker.runner import JobRunner
from steradian.storage.db.change_detector import ChangeDetector

FAST_POLL: Final = 0.01
"""Seconds between two looks at the queue just after a job's end."""
BUSY_POLL: Final = 1.0
"""Seconds between two looks while a job is at work: a worker has one at a time, and a look costs it 5 ms."""
LATEST_POLL: Final = 5.0
"""Seconds between two looks of an idle worker at a database that has not changed."""
SETTLING_TIME: Final = 10.0
"""Seconds after which the engine has started the thread of this worker's queue."""


def adaptive_wait(
    event: threading.Event, runner: JobRunner, changes: ChangeDetector, poll: float
) -> Callable[[float | None], bool]:
    """Return a replacement for ``event.wait`` that adapts the engine's polling interval to the worker's load.

    The engine polls the queue every ``poll`` seconds and between two polls waits for its stop event. The replacement
    extends that wait while a job runs or ``changes`` reports no change, and ends the wait when a job has ended. Longer
    waits are those between looks for new queues and at the engine's own queue: they are unchanged at first, because
    the engine finds this worker's queue by such a look, and later :data:`LATEST_POLL`.
    """
    plain, settled = event.wait, time.monotonic() + SETTLING_TIME

    def wait(timeout: float | None = None) -> bool:
        if timeout is None or timeout > 2 * poll:
            return plain(timeout if timeout is None or time.monotonic() < settled else max(timeout, LATEST_POLL))
        if not runner.idle.is_set():
            runner.idle.wait(BUSY_POLL)
            return event.is_set()
        if runner.is_hurried:
            return plain(min(FAST_POLL, timeout))
        while not (ended := runner.ended.wait(timeout)) and not event.is_set() and not changes.has_changed():
            pass
        if ended:
            runner.ended.clear()
        return event.is_set()

    return wait
