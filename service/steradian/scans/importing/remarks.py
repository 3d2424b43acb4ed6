"""Remarks on an import: decisions and assumptions where a file is silent, reported to the caller."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from steradian.scans.file.origin import LONGEST, MOST, printable

_collected: ContextVar[list[str] | None] = ContextVar("collected", default=None)


@contextmanager
def collecting_remarks() -> Iterator[list[str]]:
    """Collect the remarks made inside the block, each once, in the order in which they were made."""
    found: list[str] = []
    token = _collected.set(found)
    try:
        yield found
    finally:
        _collected.reset(token)


def remark(text: str) -> None:
    """Add a remark, one plain sentence; outside :func:`collecting_remarks` it is dropped."""
    found, text = _collected.get(), printable(text)[:LONGEST]
    if found is not None and text not in found and len(found) < MOST:
        found.append(text)


def remarks() -> list[str]:
    """Return the list to which :func:`remark` adds now; an empty one where nothing collects."""
    found = _collected.get()
    return [] if found is None else found
