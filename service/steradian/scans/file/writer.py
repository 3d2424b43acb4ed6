"""Durable writer of scan files: appends return after fsync.

The HDF5 library makes the file once, with every dataset allocated at its full size, and closes it
(:mod:`steradian.scans.file.create`). Appending overwrites rows in place and ends with ``fdatasync`` once a batch. The
structure of HDF5 does not change, so neither a kill nor a power cut damages it, and any reader may open a running scan.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeAlias

import google_crc32c
import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import DamagedFile, InvalidInput
from steradian.scans.file import schema
from steradian.scans.file.aline_metadata import pack_rows, row_checksums
from steradian.scans.file.columns import AlineLike, to_columns
from steradian.scans.file.create import create_scan_file, is_disk_full_error
from steradian.scans.file.h5py_errors import HDF5_ERRORS
from steradian.scans.file.locking import lock, open_for_reading
from steradian.scans.file.measurement_order import ScanProgram

if TYPE_CHECKING:
    import h5py

__all__ = ["AlineLike", "ScanFileWriter", "create_scan_file"]
_Rows: TypeAlias = NDArray[np.void] | Mapping[str, NDArray[Any]]
"""Columns of some rows by their names."""
MAX_GAP = 1 << 16
"""A batch writes a column in one piece, values between its rows with it, up to so many bytes."""


@dataclass(frozen=True, eq=False)
class UploadRecord:
    """Record of an upload: the rows that a session sent to the scanner, with tag and shot counts.

    Attributes
    ----------
    rows
        (K,) rows of the file in the order of interrogation.
    tag
        Of this upload alone.
    fired
        Shots fired for the scan before it.
    laser_shots
        The laser's own counter before it.
    """

    rows: NDArray[np.int64]
    tag: int
    fired: int
    laser_shots: int


class ScanFileWriter:
    """Durable writer of A-lines into a scan file, with an exclusive lock.

    Parameters
    ----------
    path
        A file made by :func:`create_scan_file`.

    Raises
    ------
    Conflict
        When another process writes to it.
    DamagedFile
        When it is no such file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = path.open("r+b", buffering=0)
        self._handle = self._file.fileno()
        try:
            lock(self._handle, path)
            with open_for_reading(path) as file:
                self._locate(file)
        except (OSError, *HDF5_ERRORS) as error:
            self._file.close()
            raise DamagedFile(f"{path} cannot be read as a scan: {error}") from error
        except BaseException:
            self._file.close()
            raise

    def _locate(self, file: h5py.File) -> None:
        """Read the file offsets of the datasets and the table of stored rows."""
        alines = file["alines"]
        samples = alines["samples"]
        self.course = ScanProgram.of_file(file)
        self.count, self.samples = samples.shape
        self.kind: np.dtype[Any] = np.dtype(samples.dtype)
        if self.kind not in schema.SAMPLE_KINDS:
            raise DamagedFile(f"{self.path} has samples of the kind {self.kind}; expected int16 or float32")
        self._order = self.course.order
        self._chunk_rows = samples.chunks[0]
        self._chunks = [
            samples.id.get_chunk_info_by_coord((row, 0)).byte_offset for row in range(0, self.count, self._chunk_rows)
        ]
        self._offsets = {name: alines[name].id.get_offset() for name in schema.COLUMNS}
        # not through HDF5, which may answer a second opening of a file by one process from what it remembers
        self._columns = {
            name: self._read(self._offsets[name], self.count, kind).copy() for name, kind in schema.COLUMNS.items()
        }
        self._stored: NDArray[np.bool_] = self._columns["status"] == schema.STORED
        self._fired_offset = file["fired"].id.get_offset()
        self.fired = int(self._read(self._fired_offset, 1, np.dtype(schema.FIRED))[0])
        self._run = {name: file["run"][name].id.get_offset() for name in file["run"]}

    @property
    def stored(self) -> int:
        """Number of A-lines stored so far."""
        return int(self._stored.sum())

    @property
    def missing(self) -> NDArray[np.bool_]:
        """Boolean array (F·M,): rows that hold no A-line yet."""
        missing: NDArray[np.bool_] = ~self._stored
        return missing

    def flagged(self, bits: int = 0xFFFFFFFF) -> NDArray[np.bool_]:
        """Return a boolean array (F·M,): stored A-lines with one of the given quality flags."""
        flagged: NDArray[np.bool_] = self._stored & ((self._columns["quality"] & np.uint32(bits)) != 0)
        return flagged

    def append(self, alines: Iterable[AlineLike], rows: NDArray[np.int64] | None = None) -> None:
        """Store A-lines durably (fsync); they may be acknowledged to the scanner after the return.

        Parameters
        ----------
        alines
            What came.
        rows
            Rows that were given to the scanner: A-line ``point`` belongs to row ``rows[point]``. By default all, in
            the order of interrogation.

        Raises
        ------
        InvalidInput
            When an A-line has another length or an unknown point.
        OSError
            When the disk fails; A-lines of this call may then be stored or not, earlier ones are. The same call may be
            made again.
        """
        given = self._order if rows is None else rows
        columns = to_columns(alines, self.samples, self.kind)
        points = columns.points
        if not len(points):
            return
        beyond = points[points.view(np.uint64) >= len(given)]  # as a negative one is, too
        if beyond.size:
            raise InvalidInput("point", int(beyond[0]), f"0 to {len(given) - 1}")
        places = given[points]
        new = pack_rows(columns.values)
        new["crc32c"] = row_checksums(columns.checksums, new)
        before = {name: values[places] for name, values in self._columns.items()}
        self._stored[places] = False
        try:
            self._put(places, new)
            self._write_samples(places, columns.pieces)
            self._write_columns(places)
            sync_data(self._handle)
        except BaseException:
            self._forget(places, before)
            raise
        self._stored[places] = True

    def record_shot_count(self, shots: int) -> None:
        """Store the scanner's shot count; on a full disk, postpone it to the next call."""
        self.fired = shots
        try:
            self._overwrite(self._fired_offset, np.asarray(shots, schema.FIRED).tobytes())
        except OSError as error:
            if not is_disk_full_error(error):
                raise

    def record_upload(self, upload: UploadRecord) -> None:
        """Store durably the record of the upload to the scanner that follows."""
        data = np.ascontiguousarray(upload.rows, schema.UPLOAD).tobytes()
        self._overwrite(self._run["queue"], data)
        head = [len(upload.rows), upload.tag, upload.fired, upload.laser_shots]
        crc = google_crc32c.value(data + np.array(head, schema.UPLOAD).tobytes())
        self._overwrite(self._run["upload"], np.array([*head, crc], schema.UPLOAD).tobytes())
        sync_data(self._handle)

    def last_upload(self) -> UploadRecord | None:
        """Return the record of the last upload; ``None`` if it is missing or its checksum is wrong."""
        head = self._read(self._run["upload"], schema.UPLOAD_FIELDS, schema.UPLOAD)
        count, tag, fired, laser_shots, crc = head.tolist()
        if not 0 < count <= self.count:
            return None
        rows = self._read(self._run["queue"], count, schema.UPLOAD)
        if google_crc32c.value(rows.tobytes() + head[:-1].tobytes()) != crc:
            return None
        return UploadRecord(rows.astype(np.int64), tag, fired, laser_shots)

    def set_reference(self, point: int, bias: float, sensitivity: float, reflectivity: float) -> None:
        """Store the film's tuning at a reference point at the beginning of the scan."""
        values = np.array([point, bias, sensitivity, reflectivity], schema.REFERENCE)
        self._overwrite(self._run["reference"], values.tobytes())

    def reference(self) -> tuple[int, float, float, float] | None:
        """Return the tuning stored by :meth:`set_reference`; ``None`` without one."""
        point, bias, sensitivity, reflectivity = self._read(self._run["reference"], 4, schema.REFERENCE).tolist()
        return (int(point), bias, sensitivity, reflectivity) if bias > 0 else None

    def set_status(self, rows: NDArray[np.int64], status: int) -> None:
        """Overwrite the status table of stored rows; A-lines are not modified."""
        self._columns["status"][rows] = status
        self._stored[rows] = status == schema.STORED
        for row in rows.tolist():
            self._overwrite(self._offsets["status"] + row, bytes([status]))
        sync_data(self._handle)

    def read_row(self, row: int) -> NDArray[Any]:
        """Return the samples (N_t,) of one row."""
        chunk, within = divmod(row, self._chunk_rows)
        start = self._chunks[chunk] + within * self.samples * self.kind.itemsize
        return self._read(start, self.samples, self.kind)

    def column(self, name: str) -> NDArray[Any]:
        """Return a copy of a metadata column (F·M,) by name."""
        return self._columns[name].copy()

    def close(self) -> None:
        """Flush and close the file; a file that is not closed is valid, too."""
        if not self._file.closed:
            try:
                self.record_shot_count(self.fired)
                os.fsync(self._handle)
            finally:
                self._handle = -1  # the number may soon be another file's
                self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _write_samples(self, places: NDArray[np.int64], pieces: Sequence[bytes]) -> None:
        """Write A-lines into their rows, with one write for adjacent rows."""
        size, rows, chunks = len(pieces[0]), self._chunk_rows, self._chunks
        following = places[1:]
        ends = ((following - places[:-1] != 1) | (following % rows == 0)).nonzero()[0] + 1
        starts = [0, *ends.tolist()]
        for start, end, place in zip(starts, [*starts[1:], len(pieces)], places[starts].tolist(), strict=True):
            data = pieces[start] if end == start + 1 else b"".join(pieces[start:end])
            self._overwrite(chunks[place // rows] + place % rows * size, data)

    def _write_columns(self, places: NDArray[np.int64]) -> None:
        """Write the metadata columns of the rows at ``places``; rows between them keep their values."""
        first, last = int(places.min()), int(places.max()) + 1
        for name, values in self._columns.items():
            offset, size = self._offsets[name], values.itemsize
            if (last - first) * size <= MAX_GAP:
                self._overwrite(offset + first * size, values[first:last].tobytes())
                continue
            for place in places.tolist():
                self._overwrite(offset + place * size, values[place].tobytes())

    def _put(self, places: NDArray[np.int64], rows: _Rows) -> None:
        for name, values in self._columns.items():
            values[places] = rows[name]

    def _forget(self, places: NDArray[np.int64], before: _Rows) -> None:
        """Mark the rows at ``places`` as missing, because a failed write leaves them undefined."""
        self._put(places, before)
        self._columns["status"][places] = schema.MISSING

    def _overwrite(self, offset: int, data: bytes) -> None:
        written = os.pwrite(self._handle, data, offset)
        while written < len(data):  # a write may be short
            written += os.pwrite(self._handle, data[written:], offset + written)

    def _read(self, offset: int, count: int, kind: np.dtype[Any]) -> NDArray[Any]:
        return np.frombuffer(os.pread(self._handle, count * kind.itemsize, offset), kind)


def sync_data(file: int) -> None:
    """Flush the file's data to the disk (fdatasync); its size never changes during a scan."""
    getattr(os, "fdatasync", os.fsync)(file)
