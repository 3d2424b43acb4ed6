"""MATLAB files with ``sensor_data`` and ``dt``: 7.3 (HDF5 underneath) or older, and Octave's ``save -hdf5``.

MATLAB's first axis runs fastest, so its arrays appear with their axes reversed. ``sensor_data`` is (sensor, time) or
(x, y, time) as MATLAB shows it, or a structure with the field ``p``. The sensors come from ``positions`` (sensor,
coordinate; in metres), from ``mask`` with ``dx`` (``dy``, ``dz``) – k-Wave's binary grid or its list of Cartesian
points (coordinate, sensor) – or, for an array (x, y, time), from ``dx`` alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from steradian.errors import DamagedFile, InvalidInput
from steradian.scans.importing import mat5, names, untrusted
from steradian.scans.importing.description import Description, grid_points
from steradian.scans.importing.geometry import MOST_POINTS
from steradian.scans.importing.kwave import mask_points
from steradian.scans.importing.source import Source, Stated, make_source
from steradian.scans.importing.tables import Hdf5Table, Table, scratch, slabs, spill

FORMAT = "matlab"
EMPTY = "MATLAB_empty"
"""Attribute of a variable that is [], whose dataset holds its size."""


@contextmanager
def open_matlab(path: Path, said: Description, folder: Path | None = None) -> Iterator[Source]:
    """Open a MATLAB 7.3 or Octave HDF5 file.

    Raises
    ------
    DamagedFile, InvalidInput
        When it is damaged or refused, or lacks what is needed.
    """
    with untrusted.open_untrusted(path) as file, scratch(folder) as spare:
        yield _source(file, path.name, said, spare)


@contextmanager
def open_matlab_5(path: Path, said: Description, folder: Path | None = None) -> Iterator[Source]:
    """Open a MATLAB file of version 5 to 7; raises like :func:`open_matlab`."""
    wanted = (said.array,) if said.array else names.TRACES
    with mat5.open_variables(path, (*names.NUMBERS, *names.GEOMETRY), wanted) as file, scratch(folder) as spare:
        yield _source(file, path.name, said, spare)


def _source(file: h5py.File, called: str, said: Description, spare: Any) -> Source:
    wanted = (said.array,) if said.array else names.TRACES
    name = _find(file, wanted)
    if name is None:
        raise DamagedFile(f"{called} has no variable {wanted[0]!r}")
    traces = untrusted.dataset(file, name, most_bytes=untrusted.TRACE_BYTES)
    if traces.ndim not in (2, 3):
        raise DamagedFile(f"{called}: {name} has {traces.ndim} axes; expected sensor, time or x, y, time")
    lateral = tuple(traces.shape[:0:-1])
    stated = _stated(file, lateral)
    if stated.points is None and len(lateral) == 2:
        stated = _on_grid(file, stated, lateral)
    return make_source(FORMAT, _table(traces, stated, said, spare), stated, said, called, lateral)


def _find(file: h5py.File, wanted: tuple[str, ...]) -> str | None:
    """Name of the first variable that is there and not [].

    Structures give their field ``p``, Octave's groups their ``value``.
    """
    for name in wanted:
        for place in (name, f"{name}/value", f"{name}/p", f"{name}/value/p/value"):
            found = file.get(place)
            if isinstance(found, h5py.Dataset) and found.size != 0 and not untrusted.figure(file, place, EMPTY):
                return place
    return None


def _table(traces: h5py.Dataset, stated: Stated, said: Description, spare: Any) -> Table:
    """Put the A-lines in order: reversed by MATLAB they have time first, unless they were kept (time, sensor)."""
    points = traces.size // traces.shape[0]
    sensors = said.positions if isinstance(said.positions, np.ndarray) else stated.points
    known = None if sensors is None else len(sensors)
    turned = traces.ndim == 2 and known is not None and points != known and traces.shape[0] == known
    if turned or said.axes == "time, point":
        return Hdf5Table(traces)
    if points > MOST_POINTS:
        raise InvalidInput("sensor_data", f"{points} sensors", f"at most {MOST_POINTS}")
    return spill(_as_matlab_counts(traces), spare, points, traces.shape[0], time_first=True)


def _as_matlab_counts(traces: h5py.Dataset) -> Iterator[NDArray[Any]]:
    """Time steps with the points in our order, x slowest, from axes (time, y, x)."""
    for slab in slabs(traces):
        yield slab.swapaxes(1, 2) if slab.ndim == 3 else slab


def _stated(file: h5py.File, lateral: tuple[int, ...]) -> Stated:
    interval, speed = (_number(file, wanted) for wanted in (names.INTERVAL, names.SPEED))
    weights = _find(file, names.WEIGHTS)
    return Stated(
        points=_points(file),
        weights=None if weights is None else untrusted.array(file, weights).astype(np.float64).reshape(-1),
        depth=_number(file, names.DEPTH),
        aperture=_number(file, names.APERTURE),
        sampling_interval=interval,
        sound_speed=speed,
        time_zero=_time_zero(file, lateral),
    )


def _time_zero(file: h5py.File, lateral: tuple[int, ...]) -> float | NDArray[np.float64]:
    """Time of the first sample, of all or (M,) of each sensor; an array of a form that is neither as it is."""
    name = _find(file, names.TIME_ZERO)
    if name is None or file[name].size == 1:
        return _number(file, names.TIME_ZERO) or 0.0
    values = untrusted.array(file, name, most_bytes=8 * MOST_POINTS).astype(np.float64).T
    listed = len(lateral) == 1 and max(values.shape) == values.size
    return values.reshape(-1) if listed or values.shape == lateral else values


def _number(file: h5py.File, wanted: tuple[str, ...]) -> float | None:
    name = _find(file, wanted)
    return None if name is None or file[name].size != 1 else untrusted.number(file, name)


def _points(file: h5py.File) -> NDArray[np.float64] | None:
    name = _find(file, names.POSITIONS)
    if name is not None:
        return _coordinates(untrusted.array(file, name, most_bytes=32 * MOST_POINTS), first="point")
    name = _find(file, names.MASK)
    if name is None:
        return None
    mask = untrusted.dataset(file, name)
    if mask.ndim == 2 and mask.shape[1] in (2, 3) and mask.dtype.kind == "f":
        return _coordinates(np.asarray(mask[()]), first="coordinate")
    steps = _steps(file, mask.ndim)
    counts = tuple(mask.shape[::-1])
    places = _places(mask)
    three = counts + (1,) * (3 - len(counts)), steps + (1.0,) * (3 - len(steps))
    return mask_points(places, *three)[:, : len(counts)]  # type: ignore[arg-type]


def _coordinates(values: NDArray[Any], *, first: str) -> NDArray[np.float64]:
    """Positions (M, A) from what MATLAB shows as (M, A), or as (A, M) where ``first`` is the coordinate."""
    if values.ndim != 2 or min(values.shape) > 3:
        raise DamagedFile(f"positions have the shape {values.shape[::-1]} in MATLAB; expected (sensor, x y z)")
    usual = values if first == "coordinate" else values.T
    return (usual if usual.shape[1] <= 3 else usual.T).astype(np.float64)


def _places(mask: h5py.Dataset) -> NDArray[np.int64]:
    """Places of the nonzero voxels, counted with MATLAB's first axis fastest, a slab at a time."""
    found, before, total = [], 0, 0
    for slab in slabs(mask):
        here = np.flatnonzero(slab)
        total += len(here)
        if total > MOST_POINTS:
            raise InvalidInput("mask", f"more than {MOST_POINTS} sensors", f"at most {MOST_POINTS}")
        found.append(here + before)
        before += slab.size
    return np.concatenate(found)


def _steps(file: h5py.File, axes: int) -> tuple[float, ...]:
    first = _number(file, (names.STEPS[0], names.KGRID))
    if first is None:
        raise InvalidInput("dx", "missing", "> 0 (m), the pitch of the mask's grid, as a variable beside it")
    return (first, *(_number(file, (name,)) or first for name in names.STEPS[1:axes]))


def _on_grid(file: h5py.File, stated: Stated, counts: tuple[int, ...]) -> Stated:
    if _number(file, names.STEPS[:1]) is None:
        return stated
    from dataclasses import replace

    return replace(stated, points=grid_points(counts, _steps(file, 2)))
