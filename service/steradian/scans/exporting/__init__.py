"""Export of scans: IPASC HDF5 for any scan, ``.sgl`` for grids and lines."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, TypeAlias

from steradian.core.exceptions import DamagedFile, InvalidInput, NotFound
from steradian.core.progress import CancelCheck, Progress

__all__ = ["ENDINGS", "FORMATS", "ScanFormat", "export_scan"]

FORMATS: Final = {"ipasc": (".hdf5", ".h5"), "sgl": (".sgl",)}
"""Export formats of scans with the endings that stand for them; the first is the one of exported files."""
if TYPE_CHECKING:
    ScanFormat: TypeAlias = str
else:
    ScanFormat = Literal[tuple(FORMATS)]
ENDINGS: Final[dict[str, str]] = {ending: name for name, endings in FORMATS.items() for ending in endings}
"""Format of a scan by the ending of its name."""


def export_scan(
    scan: Path,
    destination: Path,
    *,
    format: ScanFormat = "ipasc",
    frame: int | None = None,
    notes: list[str] | None = None,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Path:
    """Convert a scan file to another format.

    A-lines are as they were measured: not divided by their pulse energy, flagged ones among them. IPASC leaves out
    points that are missing in any frame, or whose samples do not match their checksum, and tells energies and flags.

    Parameters
    ----------
    scan
        A scan file, finished or not.
    destination
        Where to; a file of that name is replaced once the new one is whole.
    format
        ``ipasc``; or ``sgl`` for one frame of a scan whose points fill a grid or lie evenly on a line.
    frame
        Which frame goes into an .sgl file; needed where there are several.
    notes
        Gets what the format has no place for.
    progress, cancelled
        Reported and asked once a block; units are A-lines and detectors.

    Raises
    ------
    NotFound, DamagedFile
        When the scan cannot be read, or holds no point with all its frames.
    InvalidInput
        When the format is unknown, or cannot hold this scan.
    Cancelled
        When ``cancelled`` said so; nothing is left behind.
    """
    if format not in FORMATS:
        raise InvalidInput("format", format, " or ".join(FORMATS))
    from steradian.scans.file import schema
    from steradian.scans.file.locking import open_for_reading

    if not scan.is_file():
        raise NotFound("file", str(scan))
    if frame is not None and format != "sgl":
        raise InvalidInput("frame", frame, "none: an IPASC file holds all frames")
    destination.parent.mkdir(parents=True, exist_ok=True)
    draft = destination.with_name(f".{destination.name}.exporting")
    try:
        try:
            file = open_for_reading(scan)
        except OSError as error:
            raise DamagedFile(f"{scan} cannot be read as a scan: {error}") from error
        with file:
            schema.check_format(scan, file)
            if format == "sgl":
                from steradian.scans.exporting.sgl import write_sgl

                told = write_sgl(file, draft, destination.name, frame, progress, cancelled)
                if notes is not None:
                    notes += told
            else:
                from steradian.scans.exporting.ipasc import write_ipasc

                write_ipasc(file, draft, progress, cancelled)
        draft.replace(destination)
    finally:
        draft.unlink(missing_ok=True)
    return destination
