"""Exclusive file lock held for the duration of a block."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import filelock

from steradian.core.exceptions import Conflict


@contextmanager
def exclusive(path: Path, refusal: str) -> Iterator[None]:
    """Hold a file as a lock until the block ends; it is removed then, and the lock goes with a process that is killed.

    Raises
    ------
    Conflict
        With the refusal, when somebody else holds it.
    """
    lock = filelock.FileLock(path)
    try:
        lock.acquire(timeout=0)
    except filelock.Timeout:
        raise Conflict(refusal) from None
    try:
        yield
    finally:
        path.unlink(missing_ok=True)  # while it is held, so that nobody's but our own goes
        lock.release()
