"""Import of recordings in other formats as scan files.

What is imported counts as untrusted: see :mod:`steradian.scans.importing.untrusted`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from steradian.core.atomic_files import sync_folder
from steradian.core.exceptions import Cancelled, Conflict, NotFound
from steradian.core.progress import CancelCheck, Progress
from steradian.scans.importing import scan_files
from steradian.scans.importing.detect import is_scan_file, open_recording_source
from steradian.scans.importing.scan_writer import write_scan

__all__ = ["ImportSummary", "import_scan"]


@dataclass(frozen=True)
class ImportSummary:
    """Summary of an import: scan file, source format, number and length of A-lines, notes on decisions."""

    path: Path
    format: str
    points: int
    samples: int
    notes: tuple[str, ...] = ()


def import_scan(
    source: Path,
    destination: Path,
    *,
    description: Path | None = None,
    options: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> ImportSummary:
    """Import a recording in another format: write its A-lines into a new scan file.

    A-lines pass in blocks of a few tens of megabytes. Integers of at most 16 bits are kept as they are, other numbers
    as float32. The file appears under its name only when it is whole. A file from a stranger is better read in a
    process of its own, by :func:`steradian.scans.importing.sandbox.import_in_sandbox`.

    Parameters
    ----------
    source
        One of our scan files, IPASC HDF5, k-Wave output HDF5, MATLAB or Octave HDF5 with ``sensor_data`` and
        ``dt``, .npy, .npz, .sgl or .csv.
    destination
        The scan file to make.
    description
        JSON that says what the source does not (:mod:`steradian.scans.importing.description`).
    options
        Fields of a description that replace those of the file, in SI units.
    progress, cancelled
        Reported and asked once a block; the unit of progress is the A-line, before it in IPASC files the detector.

    Raises
    ------
    NotFound
        When a file is missing.
    DamagedFile
        When the source is of no known kind, damaged, or holds what is refused.
    InvalidInput
        When something needed is stated nowhere or out of range.
    Conflict
        When ``destination`` exists.
    Cancelled
        When ``cancelled`` said so; nothing is left behind.
    """
    if not source.is_file():
        raise NotFound("file", str(source))
    if destination.exists():
        raise Conflict(f"{destination} exists; choose another name or remove it")
    destination.parent.mkdir(parents=True, exist_ok=True)
    draft = destination.with_name(destination.name + ".importing")
    draft.unlink(missing_ok=True)
    notes: tuple[str, ...] = ()
    try:
        if is_scan_file(source):
            points, samples = scan_files.sanitise_scan(source, draft, progress=progress, cancelled=cancelled)
            kind = scan_files.FORMAT
        else:

            def note(stage: str, done: int, total: int) -> None:
                if cancelled and cancelled():
                    raise Cancelled(f"the import was stopped at {done} of {total} {stage}")
                if progress:
                    progress(stage, done, total)

            with open_recording_source(source, description, destination.parent, note, options) as opened:
                kind, points, samples = opened.format, opened.table.points * opened.table.frames, opened.table.samples
                write_scan(opened, draft, progress=progress, cancelled=cancelled)
                notes = tuple(opened.notes)
        with draft.open("rb") as raw:
            os.fsync(raw.fileno())
        draft.replace(destination)
        sync_folder(destination.parent)
    finally:
        draft.unlink(missing_ok=True)
    return ImportSummary(destination, kind, points, samples, notes)
