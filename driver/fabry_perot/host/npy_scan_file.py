"""Minimal scan recorder to a NumPy file (``.npy``)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabry_perot.errors import LeaseExpired, PlanInvalid, ScanAborted
from fabry_perot.host.aline import ALineBatch
from fabry_perot.host.scanner import Scanner

COLUMNS = {
    "scale": "f4",
    "sampling_interval": "f8",
    "fire_time_s": "f8",
    "shot": "u4",
    "averages": "u2",
    "energy": "f4",
    "wavelength_m": "f8",
    "time_zero_offset_s": "f8",
    "dc_v": "f4",
    "gain_db": "f4",
    "quality": "u1",
}
"""Fields of a row that are :class:`fabry_perot.ALine`'s; besides them ``stored``, ``x``, ``y`` (m) and ``samples``."""


def create(path: Path, points: NDArray[np.float64], samples: int) -> NDArray[np.void]:
    """Create the file of a scan, with an empty row for every A-line.

    Parameters
    ----------
    path
        A ``.npy`` file that does not exist.
    points
        (M, 2) positions in m.
    samples
        Samples per A-line.

    Raises
    ------
    PlanInvalid
        When it exists.
    """
    if path.exists():
        raise PlanInvalid("file", path, "one that does not exist")
    fields = [("stored", "u1"), ("x", "f8"), ("y", "f8"), *COLUMNS.items(), ("samples", "<i2", (samples,))]
    rows = np.lib.format.open_memmap(path, "w+", np.dtype(fields), (len(points),))
    rows["x"], rows["y"] = points.T
    rows.flush()
    return rows


def run_and_store(
    scanner: Scanner,
    rows: NDArray[np.void],
    *,
    stopping: Callable[[], bool],
    progress: Callable[[int], None],
) -> bool:
    """Run the uploaded plan and store every A-line before acknowledging it; returns whether the plan was completed.

    Parameters
    ----------
    scanner
        With the plan uploaded.
    rows
        As :func:`create` makes them.
    stopping
        Asked some twenty times a second; once it says so the laser goes off and what was fired is stored.
    progress
        Told how many A-lines are stored.

    Raises
    ------
    ScannerError
        The scanner or its link gave up; what was acknowledged is stored.
    """
    scanner.start(scanner.arm())
    stored, stopped = 0, False
    try:
        for batch in scanner.alines(idle=True):
            if batch:
                _store_batch(rows, batch)
                scanner.acknowledge(batch[-1])
                stored += len(batch)
                progress(stored)
            if stopping() and not stopped:
                scanner.abort("laser-off")
                stopped = True
            if stopped and not scanner.has_pending_data:
                break
    except (LeaseExpired, ScanAborted):
        if not stopped:
            raise
    return stored == len(rows)


def _store_batch(rows: NDArray[np.void], batch: ALineBatch) -> None:
    places = batch.column("point")
    for name in (*COLUMNS, "samples"):
        rows[name][places] = batch.column(name)
    rows["stored"][places] = 1
    rows.flush()  # type: ignore[attr-defined]  # a memmap's


def read_points(path: Path) -> NDArray[np.float64]:
    """Read (M, 2) positions in m: ``.npy`` in m, or CSV with columns x_mm, y_mm and optional others."""
    try:
        if path.suffix == ".npy":
            points = np.asarray(np.load(path, allow_pickle=False), dtype=np.float64)
        else:
            head = 0 if _is_number(path.read_text(encoding="utf-8").partition(",")[0]) else 1
            points = 1e-3 * np.loadtxt(path, delimiter=",", skiprows=head, ndmin=2)[:, :2]
    except (ValueError, IndexError) as error:
        raise PlanInvalid("points", path, f"two columns of numbers ({error})") from error
    if points.ndim != 2 or points.shape[1] != 2 or not len(points):
        raise PlanInvalid("points", f"shape {points.shape} in {path}", "(M, 2), M ≥ 1, in m")
    return points


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
