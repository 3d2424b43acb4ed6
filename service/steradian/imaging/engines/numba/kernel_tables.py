"""Conversion of sensors and modes to the layout of the CPU kernels."""

from __future__ import annotations

from math import factorial

import numpy as np
from numpy.typing import NDArray

from steradian.imaging.engines.numba.kernel_args import KappaMap, Sensors, StoredModes
from steradian.imaging.engines.numba.mode_blocks import ModeBlocks
from steradian.imaging.transform_tables import TransformTables
from steradian.imaging.transforms.lateral import GridEntries, LateralTransform, Stencils, numbers_of

Ints = NDArray[np.int64]


def sensors_of(lateral: LateralTransform, dtype: str) -> Sensors:
    """Return the kernels' sensor table, sorted by each sensor's first grid line."""
    s, lines = lateral.sensors, np.arange(lateral.grid[0] + 1)
    if isinstance(s, GridEntries):
        return _entries(s, lateral.scale, lines, dtype)
    order = np.lexsort((s.first[:, 1], s.first[:, 0]))
    return Sensors(
        True,
        order.astype(np.int64),
        lateral.scale[order].astype(dtype),
        np.searchsorted(s.first[order, 0], lines).astype(np.int64),
        np.ascontiguousarray(s.first[order, 1]),
        np.zeros(1, np.int64),
        np.ascontiguousarray(s.tx[order].astype(dtype)),
        np.ascontiguousarray(np.pad(s.ty[order], ((0, 0), (0, s.ty.shape[1] % 2))).astype(dtype)),
    )


def _entries(s: GridEntries, scale: NDArray[np.float64], lines: Ints, dtype: str) -> Sensors:
    order = np.lexsort((s.cells, s.lines))
    return Sensors(
        False,
        np.arange(len(scale)),
        scale.astype(dtype),
        np.searchsorted(s.lines[order], lines).astype(np.int64),
        s.cells[order].astype(np.int64),
        s.sensors[order].astype(np.int64),
        np.ones((1, 1), dtype),
        np.ascontiguousarray(s.weights[order][:, None].astype(dtype)),
    )


def image_points_as_sensors(tables: TransformTables) -> Sensors:
    """Return the image's points as sensors on the grid of the modes."""
    (x, nx), (y, ny) = tables.visible_region
    lines, cells = (v.ravel() for v in np.meshgrid(np.arange(x, x + nx), np.arange(y, y + ny), indexing="ij"))
    count = nx * ny
    entries = GridEntries(lines, cells, np.arange(count), np.ones(count))
    return _entries(entries, np.ones(count), np.arange(tables.lateral.modes[0] + 1), tables.dtype)


def subset(sensors: Sensors, some: Ints) -> Sensors:
    """Return the kernels' table of selected sensors, whose traces are in the order of ``some`` (each once)."""
    row = np.full(len(sensors.scale), -1, np.int64)
    row[some] = np.arange(len(some))
    rows = row[sensors.order] if sensors.separable else row[sensors.sensors]
    kept = rows >= 0
    starts = np.concatenate([[0], np.cumsum(kept)])[sensors.starts].astype(np.int64)
    first, wy = sensors.first[kept], np.ascontiguousarray(sensors.wy[kept])
    if sensors.separable:
        return sensors._replace(
            order=rows[kept], scale=sensors.scale[kept], starts=starts, first=first,
            wx=np.ascontiguousarray(sensors.wx[kept]), wy=wy,
        )  # fmt: skip
    return sensors._replace(
        order=np.arange(len(some)), scale=sensors.scale[some], starts=starts, first=first, sensors=rows[kept], wy=wy
    )


def kappa_map(tables: TransformTables, blocks: ModeBlocks) -> KappaMap:
    """Return the kernels' parameters of the interpolation at κ, of modes in blocks."""
    t, rule = tables, tables.rule
    terms = range(6 if t.dtype == "float32" else 11)
    sine = np.array([(-1) ** i / factorial(2 * i + 1) for i in terms], t.dtype)
    cosine = np.array([(-1) ** i / factorial(2 * i) for i in terms], t.dtype)
    return KappaMap(
        blocks.squares, blocks.edges, t.time.length / t.time.record, rule.turns, rule.band,
        rule.waves == "both", t.time.nearest, t.time.taps.astype(t.dtype), rule.table, rule.steps,
        rule.overlying, rule.shift, sine, cosine,
    )  # fmt: skip


def stored_modes(lateral: LateralTransform, *, edges: bool) -> StoredModes:
    """Return the table of stored modes: the requested ones, or all of the grid if the grid is coarser.

    With ``edges`` the ones at +N/2 are kept beside those at −N/2 where they differ.
    """
    nx, ny = lateral.grid
    kept = lateral.grid if lateral.replicated else lateral.modes
    jx, jy = numbers_of(kept[0]), numbers_of(kept[1])[: kept[1] // 2 + 1]
    edge_rows = np.full((len(jx), len(jy)), -1, np.int64)
    edge_swap = np.zeros(len(jy), np.bool_)
    edge_jx = jx.copy()
    if edges and not lateral.replicated:
        if kept[0] % 2 == 0 and (nx != kept[0] or lateral.shift[0]):
            edge_rows[kept[0] // 2, :] = 0
            edge_jx[kept[0] // 2] = kept[0] // 2
        if kept[1] % 2 == 0 and (ny != kept[1] or lateral.shift[1]):
            edge_rows[:, kept[1] // 2] = 0
            edge_swap[kept[1] // 2] = True
        which = edge_rows >= 0
        edge_rows[which] = 2 * (len(jx) * len(jy) + np.arange(np.count_nonzero(which)))
    return StoredModes(jx % nx, jy % ny, -jx % nx, -jy % ny, edge_jx % nx, -edge_jx % nx, edge_rows, edge_swap)


def all_stored(modes: tuple[int, int]) -> StoredModes:
    """Return the table of all modes of a grid with as many points."""
    return stored_modes(LateralTransform(modes, modes, NO_SENSORS, np.empty(0)), edges=False)


def row_count(stored: StoredModes) -> int:
    """Return the rows of storage: real and imaginary part of each mode, those at +N/2 included."""
    return 2 * (len(stored.xs) * len(stored.ys) + int(np.count_nonzero(stored.edge_rows >= 0)))


NO_SENSORS = Stencils(np.empty((0, 2), np.int64), np.empty((0, 1)), np.empty((0, 1)))
