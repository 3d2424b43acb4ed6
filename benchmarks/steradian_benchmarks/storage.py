"""Benchmark of durable write throughput of scan files, against a plain appended file."""

from __future__ import annotations

import os
import shutil
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from fabry_perot import ALineBatch
from fabry_perot.host.aline import META_SIZE
from fabry_perot.wire.framing import crc32c
from fabry_perot.wire.messages import ALineMeta, pack
from steradian.core.progress import Progress
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.scans.file.verify import verify_scan_file
from steradian.scans.file.writer import ScanFileWriter, create_scan_file

Row: TypeAlias = dict[str, Any]
SAMPLES = 1024
BATCHES = (1, 8, 32, 128, 512)
"""A-lines in a batch; each is synchronised once."""
LEAST = 0.5
"""The scan file's rate over the plain file's must not be below this."""


def storage(*, folder: Path | None = None, quick: bool = False, progress: Progress | None = None) -> list[Row]:
    """Measure the rate of durably stored A-lines of 1,024 16-bit samples.

    Parameters
    ----------
    folder
        On the disk in question; the system's temporary folder by default.
    quick
        A small version: a check that it runs, no measurement.
    progress
        Called before each batch size.

    Returns
    -------
    list of dict
        For each batch size ``alines_s`` into a scan file of a 1,605-point plan, in its order of interrogation, one
        ``fdatasync`` a batch; ``plain_s`` appended to a file without any structure, one ``fsync`` a batch; ``ratio``
        of the two, which must not be below ``limit``. Medians of runs that take turns. ``file_over_raw``: size of the
        scan file over that of its samples. ``intact``: whether the file passed its check.
    """
    count, repeats, batches = (120, 1, (8, 32)) if quick else (1605, 7, BATCHES)
    plan = ScanPlan.create(mask=equi_steradian_mask(13.56e-3, 3.6e-3, count), samples=SAMPLES)
    samples = np.random.default_rng(1).integers(-20_000, 20_000, (plan.mask.count, SAMPLES), dtype=np.int16)
    alines = [_record(number, row) for number, row in enumerate(samples)]
    home = Path(tempfile.mkdtemp(prefix="steradian-storage-", dir=folder))
    rows: list[Row] = []
    try:
        for done, batch in enumerate(batches):
            if progress is not None:
                progress("batches", done, len(batches))
            rows.append(_measure(plan, alines, batch, repeats, home))
    finally:
        shutil.rmtree(home)
    if progress is not None:
        progress("batches", len(batches), len(batches))
    return rows


def _measure(plan: ScanPlan, alines: list[bytes], batch: int, repeats: int, home: Path) -> Row:
    path, plain = home / "scan.h5", home / "plain"
    ours, theirs = [], []
    for turn in range(repeats):
        # each goes first every other time; neither profits from what the other left in the disk's buffers
        for kind in ("ours", "theirs") if turn % 2 else ("theirs", "ours"):
            if kind == "ours":
                ours.append(_scan_file(plan, alines, batch, path))
            else:
                theirs.append(_plain_file(alines, batch, plain))
    fast, yardstick = statistics.median(ours), statistics.median(theirs)
    report = verify_scan_file(path, repair=False)
    return {
        "batch": batch,
        "alines_s": len(alines) / fast,
        "plain_s": len(alines) / yardstick,
        "ratio": yardstick / fast,
        "limit": LEAST,
        "sync_ms": 1e3 * fast / (len(alines) / batch),
        "file_over_raw": path.stat().st_size / (2 * SAMPLES * len(alines)),
        "intact": report.is_consistent and report.intact == report.rows,
    }


def _scan_file(plan: ScanPlan, alines: list[bytes], batch: int, path: Path) -> float:
    """Write all A-lines into a new scan file; return the seconds, without the creation of the file."""
    path.unlink(missing_ok=True)
    create_scan_file(path, plan)
    with ScanFileWriter(path) as store:
        begin = time.perf_counter()
        for first in range(0, len(alines), batch):
            some = alines[first : first + batch]
            store.append(ALineBatch(first, range(first, first + len(some)), some))
        return time.perf_counter() - begin


def _plain_file(alines: list[bytes], batch: int, path: Path) -> float:
    """Append the samples to a new file, with one fsync a batch; return the seconds."""
    path.unlink(missing_ok=True)
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    try:
        begin = time.perf_counter()
        for first in range(0, len(alines), batch):
            data = b"".join(aline[META_SIZE:] for aline in alines[first : first + batch])
            while data:
                data = data[os.write(handle, data) :]
            os.fsync(handle)
        return time.perf_counter() - begin
    finally:
        os.close(handle)


def _record(number: int, samples: NDArray[np.int16]) -> bytes:
    """Return the record of an A-line in the form that the driver delivers."""
    data = samples.astype("<i2").tobytes()
    return (
        pack(ALineMeta(number, 1_550_000, number + 1, crc32c(data), 0.25, 8000, SAMPLES, 1, 10_000, 0, 0, 0, 0)) + data
    )
