"""Remarks on an import: notes on decisions and assumptions, collected for the caller."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from steradian.scans.file.source_metadata import LONGEST, MOST, printable

_collected: ContextVar[list[str] | None] = ContextVar("collected", default=None)


@contextmanager
def collecting_remarks() -> Iterator[list[str]]:
    """Collect the remarks added inside the block, in order and without duplicates."""
    found: list[str] = []
    token = _collected.set(found)
    try:
        yield found
    finally:
        _collected.reset(token)


def remark(text: str) -> None:
    """Add a remark of one sentence to the collected ones; ignored outside :func:`collecting_remarks`."""
    found, text = _collected.get(), printable(text)[:LONGEST]
    if found is not None and text not in found and len(found) < MOST:
        found.append(text)


def remarks() -> list[str]:
    """Return the current list of collected remarks; an empty list outside :func:`collecting_remarks`."""
    found = _collected.get()
    return [] if found is None else found
