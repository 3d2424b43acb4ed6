"""Verification of a scan file: checks every A-line's checksum and repairs the status table."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import DamagedFile, NotFound
from steradian.core.progress import Progress
from steradian.scans.file import schema
from steradian.scans.file.aline_metadata import ShotTable
from steradian.scans.file.create import geometry_checksum
from steradian.scans.file.h5py_errors import reraise_as_damaged
from steradian.scans.file.locking import open_for_reading
from steradian.scans.file.writer import ScanFileWriter

if TYPE_CHECKING:
    import h5py


@dataclass(frozen=True, eq=False)
class CheckReport:
    """Result of the verification of a scan file.

    Attributes
    ----------
    path
        The file.
    rows
        A-lines the scan is to have, of all frames.
    intact
        A-lines in the file that are proven by their checksum.
    damaged
        Rows that the table calls stored and that do not match: cut off by a power failure, or changed since.
    unlisted
        Rows that are proven, samples and columns, and that the table calls missing.
    repaired
        Whether the table was corrected.
    strength
        (rows,) rms of each intact A-line in counts, without its mean; 0 elsewhere.
    """

    path: Path
    rows: int
    intact: int
    damaged: NDArray[np.int64]
    unlisted: NDArray[np.int64]
    repaired: bool
    strength: NDArray[np.float32] = field(repr=False)

    @property
    def is_consistent(self) -> bool:
        """Whether the status table needed no correction."""
        return not len(self.damaged) and not len(self.unlisted)


def verify_scan_file(path: Path, *, repair: bool = True, progress: Progress | None = None) -> CheckReport:
    """Verify the checksums of a scan file and correct its status table; A-lines are not modified.

    A damaged A-line becomes a missing one, which a resumed scan measures again; one that the table does not list is
    listed where its checksum proves all of it.

    Parameters
    ----------
    path
        The file.
    repair
        Whether to correct the table.
    progress
        Told about each piece of the file.

    Raises
    ------
    NotFound
        When there is no such file.
    DamagedFile
        When it is no scan file, or what says where and when its A-lines were measured is damaged: that cannot be
        repaired.
    """
    if not path.is_file():
        raise NotFound("file", str(path))
    with reraise_as_damaged(path, "scan"), open_for_reading(path) as file:
        _check_frame(path, file)
        table = ShotTable.of_file(file)
        whole, strength = _verify(file, table, progress)
    listed = table.stored
    damaged, unlisted = np.flatnonzero(listed & ~whole), np.flatnonzero(~listed & whole)
    if repair and (len(damaged) or len(unlisted)):
        with ScanFileWriter(path) as store:
            store.set_status(damaged, schema.MISSING)
            store.set_status(unlisted, schema.STORED)
    return CheckReport(path, len(listed), int(whole.sum()), damaged, unlisted, repair, strength)


def _check_frame(path: Path, file: h5py.File) -> None:
    """Check format, version and geometry checksum of a scan file; raises :class:`DamagedFile`."""
    schema.check_format(path, file)
    if int(file.attrs["geometry_crc32c"]) != geometry_checksum(file):
        raise DamagedFile(f"{path}: positions, weights or order of the points do not match their checksum")


def _verify(
    file: h5py.File, table: ShotTable, progress: Progress | None
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Return a boolean array (F·M,) of intact rows, and the signal strengths of their A-lines, chunk by chunk."""
    samples, checksums = file["alines/samples"], table["crc32c"]
    candidates = checksums != 0
    count, step = len(checksums), samples.chunks[0] if samples.chunks else 64
    whole, strength = np.zeros(count, np.bool_), np.zeros(count, np.float32)
    for first in range(0, count, step):
        part = slice(first, first + step)
        if not candidates[part].any():
            continue
        rows = np.asarray(samples[part])
        whole[part] = candidates[part] & table.take(part).verify_rows(rows)
        strength[part] = rows.std(axis=1, dtype=np.float32)
        if progress is not None:
            progress("checking A-lines", min(first + step, count), count)
    strength[~whole] = 0
    return whole, strength
