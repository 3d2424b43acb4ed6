"""Reader of recordings in any supported format."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from steradian.core.exceptions import InvalidInput, NotFound
from steradian.scans.file.read import list_frames, read_scan
from steradian.scans.frames import Frame, FrameChoice
from steradian.scans.importing.detect import is_scan_file, open_recording_source
from steradian.scans.importing.source import RecordingSource
from steradian.scans.recording import Recording

FIRST = FrameChoice()
"""The choice of a caller that names no frame."""


def open_recording(path: Path, frame: int | FrameChoice = FIRST) -> Recording:
    """Read a recording from a file of any supported format, detected from the content.

    A scan file, or anything :func:`steradian.scans.importing.import_scan` reads without a description.

    Parameters
    ----------
    path
        The file.
    frame
        Which frame, or which frames' mean, of a scan that has several; by default the first, with a note.

    Raises
    ------
    NotFound
        When there is no such file.
    DamagedFile
        When it is of no known kind, truncated or inconsistent.
    InvalidInput
        When something needed is stated nowhere, or there is no such frame.
    """
    if not path.is_file():
        raise NotFound("file", str(path))
    choice = frame if isinstance(frame, FrameChoice) else FrameChoice(frame)
    if is_scan_file(path):
        numbers, notes = choice.pick(list_frames(path))
        recording = read_scan(path, numbers if choice.average else numbers[0])
        return replace(recording, notes=recording.notes + notes)
    with open_recording_source(path) as source:
        numbers, notes = choice.pick(_frames_of(source))
        if numbers != [0]:
            raise InvalidInput("frame", ", ".join(map(str, numbers)), "0 of a file that is not imported; import it")
        recording = source.recording()
    return replace(recording, notes=recording.notes + notes)


def count_frames(path: Path) -> int:
    """Return the number of frames in a file of any supported format; raises as :func:`open_recording`."""
    if not path.is_file():
        raise NotFound("file", str(path))
    if is_scan_file(path):
        return len(list_frames(path))
    with open_recording_source(path) as source:
        return len(_frames_of(source))


def _frames_of(source: RecordingSource) -> list[Frame]:
    """Return the frames of a file in another format, distributed evenly over its excitation wavelengths."""
    count, lights = source.table.frames, source.excitation or (0.0,)
    each = max(1, count // len(lights))
    return [Frame(n, lights[min(n // each, len(lights) - 1)], source.table.points) for n in range(count)]
