"""Metadata of the source of an imported scan file: the JSON attribute ``source``.

``name`` and ``format`` of that file, ``notes`` (what was decided or assumed), and what a format has that has no other
place in a scan file, under the format's own name.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import h5py


SOURCE = "source"
MOST_CHARACTERS = 60_000
"""Of the JSON: an attribute holds no more."""
MOST, LONGEST = 40, 600
"""Notes on one file, and characters of each."""


def printable(text: str) -> str:
    """Return a text without terminal control characters; undecodable bytes are replaced by a mark."""
    plain = text.encode("utf-8", "replace").decode("utf-8")
    return "".join(each for each in plain if each.isprintable())


def parse_origin(text: str | None) -> dict[str, Any]:
    """Return the object of a JSON text; empty for missing or invalid JSON."""
    try:
        said = json.loads(text or "{}")
    except (ValueError, RecursionError):
        return {}
    return said if isinstance(said, dict) else {}


def read_origin(file: h5py.File) -> dict[str, Any]:
    """Read the source metadata of an open scan file; empty without any."""
    text = file.attrs.get(SOURCE)
    return parse_origin(text if isinstance(text, str) else None)


def notes_of(said: dict[str, Any]) -> tuple[str, ...]:
    """Return the import notes from the source metadata, as plain text of bounded length."""
    notes = said.get("notes")
    if not isinstance(notes, list):
        return ()
    return tuple(printable(each)[:LONGEST] for each in notes[:MOST] if isinstance(each, str))
