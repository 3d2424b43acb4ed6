"""Thread pool for GIL-free chunks of work, with progress and cancellation."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import Cancelled
from steradian.core.progress import CancelCheck, Progress
from steradian.core.system_resources import cpu_count

Scratch = TypeVar("Scratch")
_POLL = 0.05  # seconds between two looks at the callables, at least


THREAD_LIMIT: Final = "OMP_NUM_THREADS"
"""By this variable batch systems, and the service's workers for their jobs, say how many threads a process may have."""


def available_threads() -> int:
    """Return the number of processors available to this process, limited by :data:`THREAD_LIMIT`."""
    asked = os.environ.get(THREAD_LIMIT, "").partition(",")[0].strip()  # a list is for nested teams
    there = cpu_count()
    return min(there, max(1, int(asked))) if asked.isdecimal() else there


def parallel_for(
    stage: str,
    pieces: int,
    scratch: Callable[[], Scratch],
    work: Callable[[int, Scratch, NDArray[np.uint8]], None],
    *,
    threads: int,
    progress: Progress | None,
    cancelled: CancelCheck | None,
) -> None:
    """Call ``work(i, scratch, flag)`` for i = 0 … pieces−1, on ``threads`` threads with a scratch space each.

    The calling thread is one of them and looks up between its pieces. ``flag[0]`` becomes 1 when the work is to stop
    early: on cancellation, or because another piece failed.

    Raises
    ------
    Cancelled
        If the cancel callable said so.
    """
    flag = np.zeros(1, np.uint8)
    counter, finished = iter(range(pieces)), iter(range(1, pieces + 1))  # next() on a range iterator is atomic
    done, looked = 0, time.monotonic()

    def chain(after_each: Callable[[], None]) -> None:
        nonlocal done
        try:
            space = scratch()
            for piece in counter:
                if flag[0]:
                    return
                work(piece, space, flag)
                done = next(finished)
                after_each()
        except BaseException:
            flag[0] = 1
            raise

    def look() -> None:
        if progress is not None:
            progress(stage, done, pieces)
        if cancelled is not None and cancelled():
            raise Cancelled(f"cancelled during: {stage}")

    def look_now_and_then() -> None:
        nonlocal looked
        if time.monotonic() - looked >= _POLL:
            look()
            looked = time.monotonic()

    look()
    others = min(threads, pieces) - 1
    if others < 1:
        chain(look_now_and_then)
    else:
        with ThreadPoolExecutor(others, thread_name_prefix="steradian") as pool:
            futures = [pool.submit(chain, lambda: None) for _ in range(others)]
            chain(look_now_and_then)
            for future in futures:
                future.result()
    look()
