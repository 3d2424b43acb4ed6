"""The next job is looked for at once when one has just ended."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Final

from steradian.jobs.runner import JobRunner

HURRIED_POLL: Final = 0.01
"""Seconds between two looks at the queue just after a job's end."""


def hurried(event: threading.Event, runner: JobRunner, poll: float) -> Callable[[float | None], bool]:
    """Make a wait for ``event`` that ends early after a job's end, so that the next one is looked for at once.

    The engine looks at the queue every ``poll`` seconds and waits between two looks for the event that says when to
    stop; longer waits are left as they are.
    """
    plain = event.wait

    def wait(timeout: float | None = None) -> bool:
        if timeout is None or timeout > 2 * poll:
            return plain(timeout)
        if runner.is_hurried:
            return plain(min(HURRIED_POLL, timeout))
        if runner.ended.wait(timeout):
            runner.ended.clear()
        return event.is_set()

    return wait
