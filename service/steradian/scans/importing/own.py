"""Importing one of our own scan files, from another machine or a stranger: a copy, once everything in it is checked."""

from __future__ import annotations

from pathlib import Path

import google_crc32c
import numpy as np

from steradian.errors import Cancelled, DamagedFile
from steradian.progress import IsCancelled, Progress
from steradian.scans import schema
from steradian.scans.importing import untrusted

FORMAT = "steradian"
PIECE = 8 << 20


def copy_scan(source: Path, path: Path, *, progress: Progress | None, cancelled: IsCancelled | None) -> tuple[int, int]:
    """Check a scan file and copy it; returns the numbers of stored A-lines and samples of each.

    Missing points stay missing: the copy can be continued or reconstructed like the original.

    Raises
    ------
    DamagedFile
        When a dataset is refused, the shapes do not fit each other, or an A-line does not match its checksum.
    Cancelled
        When ``cancelled`` said so.
    """
    with untrusted.open_untrusted(source) as file:
        version = file.attrs.get("schema_version")
        if version not in schema.READABLE:
            raise DamagedFile(f"{source} has schema version {version}; this program reads {schema.READABLE}")
        samples = untrusted.dataset(file, "alines/samples", most_bytes=untrusted.TRACE_BYTES)
        rows = samples.shape[0]
        points = len(untrusted.dataset(file, "mask/weights"))
        untrusted.dataset(file, "mask/positions"), untrusted.dataset(file, "plan/visit")
        if samples.ndim != 2 or samples.dtype not in schema.SAMPLE_KINDS or rows % points:
            raise DamagedFile(f"{source}: alines/samples has the shape {samples.shape} for {points} points")
        made = samples.id.get_create_plist()
        chunk = samples.chunks
        if chunk is None or chunk[1] != samples.shape[1] or made.get_nfilters():
            raise DamagedFile(f"{source}: alines/samples is no dataset in uncompressed chunks of whole rows")
        if samples.id.get_num_chunks() != -(-rows // chunk[0]):
            raise DamagedFile(f"{source}: alines/samples has not all of its chunks")
        columns = {name: untrusted.array(file, f"alines/{name}") for name in schema.COLUMNS}
        if any(column.shape != (rows,) for column in columns.values()):
            raise DamagedFile(f"{source}: the columns of alines have not {rows} values each")
        stored = columns["status"] == schema.STORED
        length = samples.shape[1]
        step = max(1, PIECE // (length * samples.dtype.itemsize))
        for start in range(0, rows, step):
            _stop_if(cancelled, start, rows)
            block = np.ascontiguousarray(samples[start : start + step])
            for row in np.flatnonzero(stored[start : start + step]):
                if google_crc32c.value(block[row].tobytes()) != columns["crc32c"][start + row]:
                    raise DamagedFile(f"{source}: A-line {start + row} does not match its checksum")
            if progress:
                progress("checked A-lines", min(start + step, rows), rows)
    _copy(source, path, progress, cancelled)
    return int(stored.sum()), length


def _copy(source: Path, path: Path, progress: Progress | None, cancelled: IsCancelled | None) -> None:
    total = source.stat().st_size
    with source.open("rb") as old, path.open("xb") as new:
        while piece := old.read(PIECE):
            _stop_if(cancelled, old.tell(), total)
            new.write(piece)
            if progress:
                progress("bytes", old.tell(), total)


def _stop_if(cancelled: IsCancelled | None, done: int, total: int) -> None:
    if cancelled and cancelled():
        raise Cancelled(f"the import was stopped at {done} of {total}")
