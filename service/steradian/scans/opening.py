"""Recordings from files of every known kind."""

from __future__ import annotations

from pathlib import Path

from steradian.errors import NotFound
from steradian.scans.importing.opening import is_own, open_source
from steradian.scans.reading import read_scan
from steradian.scans.recording import Recording


def open_recording(path: Path, frame: int | None = 0) -> Recording:
    """Read a recording from one of the known kinds of file, told apart by what is in them.

    A scan file, or anything :func:`steradian.scans.importing.import_scan` reads without a description. ``frame`` is
    the frame to take of a scan file that has several.

    Raises
    ------
    NotFound
        When there is no such file.
    DamagedFile
        When it is of no known kind, truncated or inconsistent.
    InvalidInput
        When something needed is stated nowhere.
    """
    if not path.is_file():
        raise NotFound("file", str(path))
    if is_own(path):
        return read_scan(path, frame)
    with open_source(path) as source:
        return source.recording()
