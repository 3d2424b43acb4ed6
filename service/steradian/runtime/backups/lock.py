"""Exclusive file lock as a context manager."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import filelock

from steradian.core.exceptions import Conflict


@contextmanager
def exclusive(path: Path, refusal: str) -> Iterator[None]:
    """Hold an exclusive file lock until the block ends; raises :class:`Conflict` if it is held already.

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
