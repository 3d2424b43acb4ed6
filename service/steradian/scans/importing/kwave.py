"""Import of HDF5 output files of k-Wave's compiled programs (kspaceFirstOrder).

k-Wave numbers its axes x, y, z with x fastest; an HDF5 file shows them in the opposite order. A sensor mask is a list
of places in the grid, counted from 1 with x fastest, or cuboids between two corners; the recorded pressure has one
row a time step. The output file holds the mask only when it was run with ``--copy_sensor_mask``; else a description
names the input file, which always has it. Grid point i of N lies at (i − N//2)·d.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import DamagedFile, InvalidInput
from steradian.scans.importing import untrusted
from steradian.scans.importing.aline_blocks import iter_slabs, spill_to_disk, temporary_file
from steradian.scans.importing.description import Description
from steradian.scans.importing.geometry import MOST_POINTS
from steradian.scans.importing.source import Metadata, RecordingSource, make_source

FORMAT = "k-wave"
GRID = ("Nx", "Ny", "Nz", "Nt")
"""Datasets that each k-Wave file has."""
INDEX, CORNERS = "sensor_mask_index", "sensor_mask_corners"


@contextmanager
def open_kwave(
    path: Path, said: Description, companion: Path | None, folder: Path | None = None
) -> Iterator[RecordingSource]:
    """Open an output file of k-Wave's kspaceFirstOrder as a recording source.

    Parameters
    ----------
    path
        The output file.
    said
        What the description says.
    companion
        The input file, for the sensor mask and the speed of sound, where the description names it.
    folder
        Where a scratch file may lie.

    Raises
    ------
    DamagedFile, InvalidInput
        When it is damaged or refused, or lacks what is needed.
    """
    with untrusted.open_untrusted(path) as file, temporary_file(folder) as spare:
        pressure = untrusted.dataset(file, _pressure_name(file), most_bytes=untrusted.TRACE_BYTES)
        samples = pressure.shape[0] if pressure.ndim == 4 else pressure.shape[1] if pressure.ndim == 3 else 0
        points = pressure.size // max(samples, 1)
        if not samples or (pressure.ndim == 3 and pressure.shape[0] != 1) or points > MOST_POINTS:
            raise DamagedFile(f"{path.name}: p has the shape {pressure.shape}; expected (1, time, sensor)")
        table = spill_to_disk(_steps(pressure), spare, points, samples, time_first=True)
        stated = _stated(file, samples)
        if companion is not None:
            with untrusted.open_untrusted(companion) as given:
                stated = _stated(given, samples)
        if stated.points is None and not isinstance(said.positions, np.ndarray) and said.grid is None:
            raise InvalidInput(
                "positions",
                "missing",
                f"{path.name} has no sensor mask: in a description (JSON), positions with the name of its k-Wave input "
                "file, or a list of them, or a grid",
            )
        yield make_source(FORMAT, table, stated, said, path.name)


def mask_points(
    places: NDArray[np.int64], counts: tuple[int, int, int], steps: tuple[float, float, float]
) -> NDArray[np.float64]:
    """Return the positions (M, 3) in metres of grid points with the given linear indices (from 0, x fastest).

    Raises
    ------
    DamagedFile
        When a place lies outside the grid.
    """
    if len(places) == 0 or places.min() < 0 or places.max() >= np.prod(counts, dtype=object):
        raise DamagedFile(f"the sensor mask has places outside its grid of {counts}")
    indices = np.unravel_index(places, counts, order="F")
    return np.column_stack(
        [(index - count // 2) * step for index, count, step in zip(indices, counts, steps, strict=True)]
    )


def _pressure_name(file: h5py.File) -> str:
    found = file.get("p")
    if isinstance(found, h5py.Dataset):
        return "p"
    if isinstance(found, h5py.Group) and list(found) == ["1"]:
        return "p/1"
    if isinstance(found, h5py.Group):
        raise InvalidInput("p", f"{len(found)} cuboids of sensors", "one cuboid, or a mask of single points")
    raise DamagedFile(
        f"{untrusted.name_of(file)} is a k-Wave file without recorded pressure (p); is it the input file?"
    )


def _steps(pressure: h5py.Dataset) -> Iterator[NDArray[Any]]:
    if pressure.ndim == 4:
        yield from iter_slabs(pressure)
        return
    width = pressure.shape[2] * pressure.dtype.itemsize
    rows = max(1, (16 << 20) // width)
    for start in range(0, pressure.shape[1], rows):
        yield pressure[0, start : start + rows]


def _stated(file: h5py.File, samples: int) -> Metadata:
    counts = tuple(int(untrusted.number(file, name) or 0) for name in GRID[:3])
    if not all(1 <= count <= 1 << 16 for count in counts):
        raise DamagedFile(f"{untrusted.name_of(file)} has a grid of {counts}; expected 1 to 65536 on each axis")
    steps = tuple(untrusted.number(file, name) or 0.0 for name in ("dx", "dy", "dz"))
    interval = untrusted.number(file, "dt")
    total = int(untrusted.number(file, "Nt") or samples)
    skipped = max(0, total - samples)  # recording may begin late; it always runs to the end
    return Metadata(
        points=_sensor_points(file, counts, steps),  # type: ignore[arg-type]
        sampling_interval=interval,
        sound_speed=_sound_speed(file),
        time_zero=skipped * (interval or 0.0),
        scanner="k-Wave",
        simulated=True,
    )


def _sensor_points(
    file: h5py.File, counts: tuple[int, int, int], steps: tuple[float, float, float]
) -> NDArray[np.float64] | None:
    if INDEX in file:
        places = untrusted.array(file, INDEX, most_bytes=8 * MOST_POINTS).reshape(-1)
        return mask_points(places.astype(np.int64) - 1, counts, steps)
    if CORNERS not in file:
        return None
    corners = untrusted.array(file, CORNERS, most_bytes=1 << 20).reshape(6, -1)
    if corners.shape[1] != 1:
        raise InvalidInput(CORNERS, f"{corners.shape[1]} cuboids", "one cuboid, or a mask of single points")
    first, last = corners[:3, 0].astype(np.int64) - 1, corners[3:, 0].astype(np.int64)
    if (first < 0).any() or (last > counts).any() or (last <= first).any() or np.prod(last - first) > MOST_POINTS:
        raise DamagedFile(f"{untrusted.name_of(file)}: the cuboid of sensors lies outside the grid of {counts}")
    axes = [np.arange(low, high) for low, high in zip(first, last, strict=True)]
    z, y, x = (axis.ravel() for axis in np.meshgrid(*axes[::-1], indexing="ij"))  # x fastest, as the pressure has it
    return mask_points(np.ravel_multi_index((x, y, z), counts, order="F"), counts, steps)


def _sound_speed(file: h5py.File) -> float | None:
    """Return the speed of sound of a uniform medium, else k-Wave's reference speed."""
    uniform = file.get("c0")
    if isinstance(uniform, h5py.Dataset) and uniform.size == 1:
        return untrusted.number(file, "c0")
    return untrusted.number(file, "c_ref")
