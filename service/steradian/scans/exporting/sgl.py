"""Export of scans as ``.sgl``, the raw format of LabVIEW-controlled Fabry–Pérot scanners.

The layout is that of :mod:`steradian.scans.importing.sgl`. A scan that came from such a file gets its header and its
trailing numbers back as they were, so that the bytes are the same; others get eight numbers, NaN where the scan does
not know one.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import Cancelled, DamagedFile, InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging.geometry.sensor_areas import detect_sensor_grid
from steradian.scans.file.aline_metadata import ShotTable
from steradian.scans.file.arrangement_metadata import arrangement_of, centre_of
from steradian.scans.file.source_metadata import read_origin
from steradian.scans.importing import sgl
from steradian.scans.importing.sgl_name import read_name

BLOCK_BYTES = 8 << 20
SAME = 1e-6
"""Relative difference of steps below which a header that was kept is the scan's."""
WHOLE = 1e-3
"""So many samples a time zero may be beside a whole number of them."""


@dataclass(frozen=True)
class _Grid:
    """Regular grid of a scan's points: counts, steps and first coordinates (m), and each point's grid index."""

    counts: tuple[int, int]
    steps: tuple[float, float]
    first: tuple[float, float]
    places: NDArray[np.int64]


def write_sgl(
    scan: h5py.File,
    draft: Path,
    name: str,
    frame: int | None,
    progress: Progress | None,
    cancelled: CancelCheck | None,
) -> list[str]:
    """Write one frame of an open scan file as ``.sgl``; return notes on data that the format cannot store.

    Parameters
    ----------
    scan, draft
        From and to where.
    name
        The name that the file is going to have, which may state the time zero.
    frame
        Which frame; ``None`` where there is only one.
    progress, cancelled
        Reported and asked once a block of A-lines.

    Raises
    ------
    DamagedFile
        When an A-line does not match its checksum.
    InvalidInput
        When the format cannot hold the scan: no grid, missing points, several frames, A-lines that begin at different
        times.
    Cancelled
        When ``cancelled`` said so.
    """
    grid = _grid(scan)
    frames = len(scan["alines/status"]) // len(grid.places)
    chosen = _frame(frame, frames)
    rows = slice(chosen * len(grid.places), (chosen + 1) * len(grid.places))
    table = ShotTable.of_file(scan, rows)
    if not table.stored.all():
        missing = int((~table.stored).sum())
        raise InvalidInput("scan", f"{missing} of {len(table.stored)} points missing", "every point of the grid")
    notes = _notes_on_time(scan, table, name)
    header, trailer = _numbers(scan, grid, chosen, table)
    with draft.open("wb") as file:
        file.write(header)
        _samples(scan, rows, table, grid.places, file, progress, cancelled)
        file.write(trailer)
    return notes


def _grid(scan: h5py.File) -> _Grid:
    """Return the regular grid of a scan's points; raises :class:`InvalidInput` if the points do not fill a grid."""
    positions = np.asarray(scan["mask/positions"], np.float64)
    said = arrangement_of(scan["mask"])
    if positions.shape[1] == 2:
        for axis in range(2):
            if np.ptp(positions[:, axis]) == 0 and len(positions) > 1:  # a line in the plane
                return _line(positions[:, 1 - axis], along=1 - axis, centre=_centre(said, 2), other=positions[0, axis])
    else:
        along = 1 if said.get("axes") == ["y"] else 0
        return _line(positions[:, 0], along=along, centre=_centre(said, 1))
    lattice = detect_sensor_grid(positions)
    if lattice is None:
        raise InvalidInput("scan", f"{len(positions)} points that fill no grid", "a grid or a line of even steps")
    places = np.rint((positions - lattice.first) / lattice.pitch).astype(np.int64)
    nx, ny = map(int, lattice.counts)
    first = lattice.first + _centre(said, 2)
    return _Grid((nx, ny), _pair(lattice.pitch), _pair(first), places[:, 1] * nx + places[:, 0])


def _centre(said: dict[str, Any], axes: int) -> NDArray[np.float64]:
    return np.array(centre_of(said, axes) or (0.0,) * axes)


def _line(points: NDArray[np.float64], *, along: int, centre: NDArray[np.float64], other: float = 0.0) -> _Grid:
    lattice = detect_sensor_grid(points[:, None])
    if lattice is None:
        raise InvalidInput("scan", f"{len(points)} points on a line", "two or more in even steps")
    places = np.rint((points - lattice.first[0]) / lattice.pitch[0]).astype(np.int64)
    step, count = float(lattice.pitch[0]), len(points)
    first = [float(other), float(other)]
    first[along] = float(lattice.first[0])
    first = [low + shift for low, shift in zip(first, np.broadcast_to(centre, 2), strict=True)]
    if len(centre) == 1:
        first[1 - along] = 0.0
    return _Grid((1, count) if along else (count, 1), (step, step), (first[0], first[1]), places)


def _pair(values: NDArray[np.float64]) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def _frame(frame: int | None, frames: int) -> int:
    if frame is None and frames > 1:
        raise InvalidInput("frame", "missing", f"0 to {frames - 1}: an .sgl file holds one frame")
    if frame is not None and not 0 <= frame < frames:
        raise InvalidInput("frame", frame, f"0 to {frames - 1}")
    return frame or 0


def _notes_on_time(scan: h5py.File, table: ShotTable, name: str) -> list[str]:
    """Return notes on a time zero that the file name does not state; raise InvalidInput for a wrong one."""
    starts = np.asarray(table["time_zero_s"], np.float64)
    interval = float(scan["plan"].attrs["sampling_interval_s"])
    if np.ptp(starts) > WHOLE * interval:
        spread = 1e9 * float(np.ptp(starts))
        raise InvalidInput("scan", f"A-lines that begin up to {spread:.4g} ns apart", "one time zero for all")
    samples = float(starts.min()) / interval
    whole, stated = round(samples), read_name(name).time_zero
    exact = abs(samples - whole) <= WHOLE
    if stated is not None and not (exact and stated == whole):
        raise InvalidInput(
            "destination", name, f"t0[{whole}] in the name, or none: A-lines begin at {samples:.5g} samples"
        )
    if stated is None and samples and exact:
        return [
            f"A-lines begin {whole} samples after the pulse, which only the file name can state: add _t0[{whole}] to it"
        ]
    if not exact:
        return [f"A-lines begin {samples:.5g} samples after the pulse, which an .sgl file cannot state"]
    return []


def _numbers(scan: h5py.File, grid: _Grid, frame: int, table: ShotTable) -> tuple[bytes, bytes]:
    """Return header and trailer bytes: those of the imported .sgl file if they match the scan, else new ones."""
    samples = scan["alines/samples"].shape[1]
    interval = float(scan["plan"].attrs["sampling_interval_s"])
    header = [*grid.counts, samples, *(1e6 * step for step in grid.steps), 1e9 * interval]
    width = sgl.KIND.itemsize * len(sgl.HEADER)
    kept = _kept(scan)
    if len(kept) >= width and _fits(np.frombuffer(kept[:width], sgl.KIND), header, grid):
        return kept[:width], kept[width:]
    light = float(scan["plan/frame_excitation"][frame]) if "plan/frame_excitation" in scan else 0.0
    averages = int(scan["plan"].attrs["averages"])
    trailer = [frame, averages, np.nan, np.nan, 1e9 * light, np.nan, *(1e3 * low for low in grid.first)]
    return np.array(header, sgl.KIND).tobytes(), np.array(trailer, sgl.KIND).tobytes()


def _kept(scan: h5py.File) -> bytes:
    """Return header and trailer bytes of the .sgl file that a scan was imported from; empty for other scans."""
    said = read_origin(scan).get(sgl.FORMAT)
    text = said.get("bytes") if isinstance(said, dict) else None
    try:
        data = bytes.fromhex(text) if isinstance(text, str) else b""
    except ValueError:
        return b""
    most = sgl.KIND.itemsize * (len(sgl.HEADER) + len(sgl.TRAILER))
    return data if len(data) <= most and len(data) % sgl.KIND.itemsize == 0 else b""


def _fits(kept: NDArray[Any], wanted: list[float], grid: _Grid) -> bool:
    """Return whether the header of the imported .sgl file describes the scan (counts, steps and interval)."""
    matters = np.array([True, True, True, grid.counts[0] > 1, grid.counts[1] > 1, True])
    with np.errstate(invalid="ignore"):
        near = np.isclose(kept.astype(np.float64), wanted, rtol=SAME, atol=0)
    return bool((near | ~matters).all())


def _samples(
    scan: h5py.File,
    rows: slice,
    table: ShotTable,
    places: NDArray[np.int64],
    file: Any,
    progress: Progress | None,
    cancelled: CancelCheck | None,
) -> None:
    """Write the samples, time slowest, in blocks of A-lines through a memory map of the file."""
    samples, points = scan["alines/samples"], len(places)
    count, offset = samples.shape[1], file.tell()
    size = sgl.KIND.itemsize * count * points
    file.flush()
    _reserve(file.fileno(), offset, size)
    made = np.memmap(file.name, sgl.KIND, "r+", offset, (count, points))
    step = max(1, BLOCK_BYTES // (4 * count))
    for start in range(0, points, step):
        stop = min(start + step, points)
        if cancelled and cancelled():
            raise Cancelled(f"the export was stopped at {start} of {points} A-lines")
        block, part = samples[rows.start + start : rows.start + stop], table.take(slice(start, stop))
        if not part.verify_rows(block).all():
            wrong = start + int(np.flatnonzero(~part.verify_rows(block))[0])
            raise DamagedFile(f"A-line {wrong} of {scan.filename} does not match its checksum")
        scale = np.asarray(part["scale"], np.float32)[:, None]
        made[:, places[start:stop]] = (block * scale).astype(np.float32).T
        if progress:
            progress("A-lines", stop, points)
    made.flush()
    del made
    file.seek(offset + size)


def _reserve(file: int, offset: int, size: int) -> None:
    """Allocate disk space for the memory map, so that a full disk raises an error instead of a SIGBUS."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file, offset, size)
    else:
        os.truncate(file, offset + size)
