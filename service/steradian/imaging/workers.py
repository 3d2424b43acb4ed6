"""Threads for pieces of work that release the interpreter lock, with progress and cancellation."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from steradian.errors import Cancelled
from steradian.progress import IsCancelled, Progress

Scratch = TypeVar("Scratch")
_POLL = 0.05  # seconds between two looks at the cancel callable


def available() -> int:
    """Processors this process may use."""
    try:
        return max(1, len(os.sched_getaffinity(0)))
    except AttributeError:  # not on macOS or Windows
        return max(1, os.cpu_count() or 1)


def run(
    stage: str,
    pieces: int,
    scratch: Callable[[], Scratch],
    work: Callable[[int, Scratch, NDArray[np.uint8]], None],
    *,
    threads: int,
    progress: Progress | None,
    cancelled: IsCancelled | None,
) -> None:
    """Call ``work(i, scratch, flag)`` for i = 0 … pieces−1, on ``threads`` threads with a scratch space each.

    ``flag[0]`` becomes 1 when the work is to stop early: on cancellation, or because another piece failed.

    Raises
    ------
    Cancelled
        If the cancel callable said so.
    """
    flag = np.zeros(1, np.uint8)
    done = 0
    counter = iter(range(pieces))

    def chain() -> None:
        space = scratch()
        for piece in counter:  # next() on a range iterator is atomic
            if flag[0]:
                return
            work(piece, space, flag)
            nonlocal done
            done += 1

    def look() -> None:
        if progress is not None:
            progress(stage, done, pieces)
        if cancelled is not None and cancelled():
            raise Cancelled(f"cancelled during: {stage}")

    look()
    if threads == 1 and cancelled is None and progress is None:
        chain()
    else:
        with ThreadPoolExecutor(min(threads, pieces), thread_name_prefix="steradian") as pool:
            pending: set[Future[None]] = {pool.submit(chain) for _ in range(min(threads, pieces))}
            try:
                while pending:
                    finished, pending = wait(pending, _POLL, FIRST_COMPLETED)
                    for future in finished:
                        future.result()
                    if pending:
                        look()
            except BaseException:
                flag[0] = 1
                raise
    look()
