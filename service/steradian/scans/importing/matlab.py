"""Import of MATLAB and Octave files with the variables ``sensor_data`` and ``dt``.

MATLAB's first axis runs fastest, so its arrays appear with their axes reversed. ``sensor_data`` is (sensor, time) or
(x, y, time) as MATLAB shows it, or a structure with the field ``p``. The sensors come from ``positions`` (sensor,
coordinate; in metres), from ``mask`` with ``dx`` (``dy``, ``dz``) – k-Wave's binary grid or its list of Cartesian
points (coordinate, sensor) – or, for an array (x, y, time), from ``dx`` alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import DamagedFile, InvalidInput
from steradian.scans.importing import mat5, untrusted
from steradian.scans.importing import variable_aliases as names
from steradian.scans.importing.aline_blocks import (
    Hdf5TraceBlocks,
    TraceBlocks,
    iter_slabs,
    mapped,
    spill_to_disk,
    temporary_file,
)
from steradian.scans.importing.axes import axes_of, table_of
from steradian.scans.importing.axis_inference import longest_delay, time_axis
from steradian.scans.importing.description import Description, grid_points
from steradian.scans.importing.geometry import MOST_POINTS
from steradian.scans.importing.import_remarks import remark
from steradian.scans.importing.kwave import mask_points
from steradian.scans.importing.kwave_p import placing_arrays
from steradian.scans.importing.mask_order import Order, settle_order, written_by_python
from steradian.scans.importing.source import Metadata, RecordingSource, make_source

FORMAT = "matlab"
EMPTY = "MATLAB_empty"
"""Attribute of a variable that is [], whose dataset holds its size."""


@contextmanager
def open_matlab(path: Path, said: Description, folder: Path | None = None) -> Iterator[RecordingSource]:
    """Open a MATLAB 7.3 or Octave HDF5 file as a recording source.

    Raises
    ------
    DamagedFile, InvalidInput
        When it is damaged or refused, or lacks what is needed.
    """
    with untrusted.open_untrusted(path) as file, temporary_file(folder) as spare:
        yield _source(file, said, spare, path, by_matlab=_by_matlab(path))


@contextmanager
def open_matlab_5(path: Path, said: Description, folder: Path | None = None) -> Iterator[RecordingSource]:
    """Open a MATLAB file of versions 5 to 7 as a recording source; raises like :func:`open_matlab`."""
    wanted = wanted_names(said)
    with mat5.open_variables(path, (*names.NUMBERS, *names.GEOMETRY), wanted) as file, temporary_file(folder) as spare:
        yield _source(file, said, spare, path, by_matlab=True)


def _source(file: h5py.File, said: Description, spare: Any, path: Path, *, by_matlab: bool) -> RecordingSource:
    called = path.name
    wanted = wanted_names(said)
    name = _find(file, wanted)
    if name is None:
        raise DamagedFile(f"{called} has no variable {wanted[0]!r} with numbers in it")
    traces = untrusted.dataset(file, name, most_bytes=untrusted.TRACE_BYTES)
    reversed_axes = by_matlab or name.endswith("/value") or "MATLAB_class" in traces.attrs
    points = _points(file, reversed_axes=reversed_axes)
    known = said.sensors or (None if points is None else len(points))
    order = _order(traces, said, known, called, reversed_axes=reversed_axes)
    lateral = tuple(traces.shape[order.index(each)] for each in ("point", "x", "y") if each in order)
    stated = _stated(file, lateral, points)
    if stated.points is None and len(lateral) == 2:
        stated = _on_grid(file, stated, lateral)
    table = _table(traces, order, spare)
    if stated.points is not None and _mask(file) is not None and said.positions is None and said.grid is None:
        stated = _in_order(file, table, stated, said, path, reversed_axes=reversed_axes)
    return make_source(FORMAT, table, stated, said, called, lateral)


def _in_order(
    file: h5py.File, table: TraceBlocks, stated: Metadata, said: Description, path: Path, *, reversed_axes: bool
) -> Metadata:
    """Sort the points of a binary mask in the order of the A-lines."""
    interval = said.seconds(said.sampling_interval) or stated.sampling_interval or 0.0
    speed = said.sound_speed or stated.sound_speed or 1500.0
    delay = longest_delay(_steps(file, 1)[0], speed, interval)
    usual: Order = "matlab" if reversed_axes else "python"
    python = written_by_python(path) if _by_matlab(path) else not reversed_axes
    where = np.asarray(stated.points, np.float64)
    points = settle_order(table, where, said.mask_order, usual, delay, python=python)
    return replace(stated, points=points)


def _mask(file: h5py.File) -> h5py.Dataset | None:
    """Return the binary sensor mask if the file has one and no positions; else ``None``."""
    name = None if _find(file, names.POSITIONS) else _find(file, names.MASK)
    if name is None:
        return None
    mask = untrusted.dataset(file, name)
    return None if mask.ndim == 2 and mask.shape[1] in (2, 3) and mask.dtype.kind == "f" else mask


def wanted_names(said: Description) -> tuple[str, ...]:
    """Return the variable names under which A-lines are searched for, structure fields written with a dot."""
    return (said.array.replace(".", "/"),) if said.array else names.TRACES


def _by_matlab(path: Path) -> bool:
    """Return whether an HDF5 file was written as MATLAB 7.3, according to its header block."""
    with path.open("rb") as file:
        return file.read(6) == b"MATLAB"


def _find(file: h5py.File, wanted: tuple[str, ...]) -> str | None:
    """Return the name of the first of several variables that exists and is not empty.

    Structures give their field ``p``, Octave's groups their ``value``.
    """
    for name in wanted:
        nested = f"{name.replace('/', '/value/')}/value"  # Octave's
        for place in (name, nested, f"{name}/p", f"{name}/value/p/value"):
            found = file.get(place)
            if (
                isinstance(found, h5py.Dataset)
                and found.size != 0
                and not untrusted.float_attribute(file, place, EMPTY)
            ):
                return place
    return None


def _order(
    traces: h5py.Dataset, said: Description, known: int | None, called: str, *, reversed_axes: bool
) -> tuple[str, ...]:
    """Return the axis names of the A-lines in storage order, which for MATLAB is reversed.

    What a description says is about the axes as the program that wrote the file shows them.
    """
    if said.order is not None:
        shown = axes_of(said.order, traces.ndim, called)
        return shown[::-1] if reversed_axes else shown
    if traces.ndim not in (2, 3):
        raise DamagedFile(
            f"{called}: the A-lines have {traces.ndim} axes; expected sensor, time or x, y, time; a description names "
            'more, "axes": "frame, sensor, time"'
        )
    if traces.ndim == 2:
        return _order_of_two(traces, known, reversed_axes=reversed_axes)
    return _order_of_three(traces, reversed_axes=reversed_axes)


def _order_of_two(traces: h5py.Dataset, known: int | None, *, reversed_axes: bool) -> tuple[str, ...]:
    stored, turned = ("time", "point"), ("point", "time")
    if known is not None and known in traces.shape and traces.shape[0] != traces.shape[1]:
        return turned if traces.shape[0] == known else stored
    time = time_axis(traces, (0, 1))
    usual = 0 if reversed_axes else None
    if time is None and usual is None:
        raise InvalidInput(
            "axes",
            f"an array of the shape {traces.shape}, by its samples either (time, sensor) or (sensor, time)",
            'the order in a description, "axes": "time, sensor" or "sensor, time"',
        )
    if time is not None and time != usual:
        shown = "(time, sensor)" if (time == 0) != reversed_axes else "(sensor, time)"
        remark(f"the A-lines were taken as {shown}: along that time axis their beginning is quiet")
    return turned if (usual if time is None else time) == 1 else stored


def _order_of_three(traces: h5py.Dataset, *, reversed_axes: bool) -> tuple[str, ...]:
    """Return the axis names of a three-axis array, with time as first or last axis according to the samples."""
    time = time_axis(traces, (0, 2))
    if reversed_axes:
        if time == 2:
            remark("the A-lines were taken as (time, x, y): along the first axis their beginning is quiet")
            return ("y", "x", "time")
        return ("time", "y", "x")
    if time is None:
        raise InvalidInput(
            "axes",
            f"an array of the shape {traces.shape} that is not MATLAB's, in which time cannot be told",
            'the order in a description, "axes": "x, y, time" or "time, x, y"',
        )
    order = ("x", "y", "time") if time == 2 else ("time", "x", "y")
    remark(f"the A-lines were taken as ({', '.join(order)}): along that time axis their beginning is quiet")
    return order


def _table(traces: h5py.Dataset, order: tuple[str, ...], spare: Any) -> TraceBlocks:
    """Return the A-lines as a table with x as the slowest axis."""
    points = prod(count for count, name in zip(traces.shape, order, strict=True) if name in ("point", "x", "y"))
    if points > MOST_POINTS:
        raise InvalidInput("sensor_data", f"{points} sensors", f"at most {MOST_POINTS}")
    if order == ("point", "time"):
        return Hdf5TraceBlocks(traces)
    if order in (("time", "point"), ("time", "x", "y"), ("time", "y", "x")):
        turn = order == ("time", "y", "x")
        pieces = (slab.swapaxes(1, 2) if turn else slab for slab in iter_slabs(traces))
        return spill_to_disk(pieces, spare, points, traces.shape[0], time_first=True)
    spilt = spill_to_disk(iter_slabs(traces), spare, traces.size, 1, time_first=False)
    return table_of(mapped(spare, 0, spilt.dtype, traces.shape), order)


def _stated(file: h5py.File, lateral: tuple[int, ...], points: NDArray[np.float64] | None) -> Metadata:
    interval, rate, speed = (_number(file, wanted) for wanted in (names.INTERVAL, names.RATE, names.SPEED))
    if interval is None and rate:
        interval = 1 / rate
    weights, energies = _find(file, names.WEIGHTS), _find(file, names.ENERGIES)
    return Metadata(
        points=points,
        weights=None if weights is None else untrusted.array(file, weights).astype(np.float64).reshape(-1),
        depth=_number(file, names.DEPTH),
        aperture=_number(file, names.APERTURE),
        sampling_interval=interval,
        sound_speed=speed,
        time_zero=_time_zero(file, lateral),
        energies=None if energies is None else untrusted.array(file, energies).astype(np.float64),
        placing=placing_arrays("the A-lines"),
    )


def _time_zero(file: h5py.File, lateral: tuple[int, ...]) -> float | NDArray[np.float64]:
    """Return the time of the first sample, for all sensors or each (M,); arrays of other shapes unchanged."""
    name = _find(file, names.TIME_ZERO)
    if name is None or file[name].size == 1:
        return _number(file, names.TIME_ZERO) or 0.0
    values = untrusted.array(file, name, most_bytes=8 * MOST_POINTS).astype(np.float64).T
    listed = len(lateral) == 1 and max(values.shape) == values.size
    return values.reshape(-1) if listed or values.shape == lateral else values


def _number(file: h5py.File, wanted: tuple[str, ...]) -> float | None:
    name = _find(file, wanted)
    return None if name is None or file[name].size != 1 else untrusted.number(file, name)


def _points(file: h5py.File, *, reversed_axes: bool) -> NDArray[np.float64] | None:
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
    if not reversed_axes:  # the program's first axis is the slowest
        indices = np.unravel_index(places, mask.shape)
        lines = zip(indices, mask.shape, steps, strict=True)
        return np.column_stack([(index - count // 2) * step for index, count, step in lines])
    three = counts + (1,) * (3 - len(counts)), steps + (1.0,) * (3 - len(steps))
    return mask_points(places, *three)[:, : len(counts)]  # type: ignore[arg-type]


def _coordinates(values: NDArray[Any], *, first: str) -> NDArray[np.float64]:
    """Return positions (M, A) from a MATLAB array of shape (M, A) or (A, M)."""
    if values.ndim != 2 or min(values.shape) > 3:
        raise DamagedFile(f"positions have the shape {values.shape[::-1]} in MATLAB; expected (sensor, x y z)")
    usual = values if first == "coordinate" else values.T
    return (usual if usual.shape[1] <= 3 else usual.T).astype(np.float64)


def _places(mask: h5py.Dataset) -> NDArray[np.int64]:
    """Return the linear indices of the mask's nonzero voxels in MATLAB's order (first axis fastest)."""
    found, before, total = [], 0, 0
    for slab in iter_slabs(mask):
        here = np.flatnonzero(slab)
        total += len(here)
        if total > MOST_POINTS:
            raise InvalidInput("mask", f"more than {MOST_POINTS} sensors", f"at most {MOST_POINTS}")
        found.append(here + before)
        before += slab.size
    return np.concatenate(found)


def _steps(file: h5py.File, axes: int) -> tuple[float, ...]:
    first = _number(file, (names.STEPS[0], names.KGRID[0]))
    if first is None:
        raise InvalidInput("dx", "missing", "> 0 (m), the pitch of the mask's grid, as a variable beside it")
    return (first, *(_number(file, each) or first for each in list(zip(names.STEPS, names.KGRID, strict=True))[1:axes]))


def _on_grid(file: h5py.File, stated: Metadata, counts: tuple[int, ...]) -> Metadata:
    if _number(file, (names.STEPS[0], names.KGRID[0])) is None:
        return stated
    return replace(stated, points=grid_points(counts, _steps(file, 2)))
