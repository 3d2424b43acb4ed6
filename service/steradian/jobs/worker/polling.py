"""Adaptive polling: poll fast right after a job, slowly while one runs, on database change otherwise."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Final

from steradian.jobs.worker.runner import JobRunner
from steradian.storage.db.change_detector import ChangeDetector

FAST_POLL: Final = 0.01
"""Seconds between two looks at the queue just after a job's end."""
BUSY_POLL: Final = 1.0
"""Seconds between two looks while a job is at work: a worker has one at a time, and a look costs it 5 ms."""


def adaptive_wait(
    event: threading.Event, runner: JobRunner, changes: ChangeDetector, poll: float
) -> Callable[[float | None], bool]:
    """Make a wait for ``event`` that lasts while a job is at work and ends with it, so that the next begins at once.

    The engine looks at the queue every ``poll`` seconds and waits between two looks for the event that says when to
    stop; here it goes on waiting while ``changes`` tells of none. Longer waits are left as they are.
    """
    plain = event.wait

    def wait(timeout: float | None = None) -> bool:
        if timeout is None or timeout > 2 * poll:
            return plain(timeout)
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
