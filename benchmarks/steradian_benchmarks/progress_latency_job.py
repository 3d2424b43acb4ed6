"""Job that reports the current time, to measure progress latency."""

from __future__ import annotations

import time
from typing import Any

from steradian.core.progress import Progress
from steradian.jobs.worker.process import child_main

TURN = 2**30
"""Milliseconds after which the time begins again; counts in the database are 32-bit."""


def milliseconds() -> int:
    """Return the current time in ms, modulo :data:`TURN`."""
    return int(1e3 * time.time()) % TURN


def work(payload: dict[str, Any], progress: Progress) -> dict[str, Any]:
    """Report the current time as progress every ``every`` seconds for ``seconds`` seconds."""
    request = payload["request"]
    end = time.monotonic() + request["seconds"]
    while time.monotonic() < end:
        progress("clock", milliseconds(), TURN)
        time.sleep(request["every"])
    return {}


if __name__ == "__main__":
    child_main(work)
