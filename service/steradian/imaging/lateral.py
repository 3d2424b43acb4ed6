"""Tables of the lateral transforms: grid, stencils of the sensors, where each mode is read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from steradian.imaging.filling import filling
from steradian.imaging.volume import RealArray
from steradian.imaging.windows import Window

Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Spread:
    """How the traces come onto the grid [line x][cell y].

    With ``separable``, packed trace m adds to cells first[m] … of the lines following its bin, bins being given by
    ``starts``, with taps wx[m] · wy[m]. Else entry e of a line adds wy[e, 0] times trace sensors[e] to cell first[e].
    """

    separable: bool
    order: Ints
    scale: RealArray
    starts: Ints
    first: Ints
    sensors: Ints
    wx: RealArray
    wy: RealArray


@dataclass(frozen=True, slots=True)
class Lateral:
    """Grid and stored modes.

    Parameters
    ----------
    grid
        Points (nx, ny); nx = 1 in 2-D.
    spread
        From traces to grid.
    xs, ys
        Grid index of each stored mode along x (all) and y (the non-negative half).
    xs_opposite, ys_opposite
        Of the mode with the opposite sign.
    edge_xs, edge_xs_opposite, edge_rows, edge_swap
        Even numbers of modes: the Nyquist mode is read at −N/2, and for the conjugate half at +N/2 as well, which
        differs unless the sensors are on the grid. ``edge_rows[i, k]`` is the storage row of the latter, or −1.
    replicated
        The grid is coarser than the modes; its spectrum repeats and all of its modes are stored.
    shift
        Distance of the sensors from the grid's points, in cells (NER with the grid displaced).
    windows
        Windows along x and y, None where sensors are on the grid.
    """

    grid: tuple[int, int]
    spread: Spread
    xs: Ints
    ys: Ints
    xs_opposite: Ints
    ys_opposite: Ints
    edge_xs: Ints
    edge_xs_opposite: Ints
    edge_rows: Ints
    edge_swap: NDArray[np.bool_]
    replicated: bool
    shift: tuple[float, float]
    windows: tuple[Window | None, Window | None]

    @property
    def rows(self) -> int:
        """Rows of storage: real and imaginary part of each stored mode, Nyquist copies included."""
        return 2 * (len(self.xs) * len(self.ys) + int(np.count_nonzero(self.edge_rows >= 0)))


def grid_of(places: NDArray[np.float64], modes: tuple[int, ...], accuracy: float) -> list[tuple[int, float]] | None:
    """Per axis the grid (points a period, displacement in cells) all sensors are on, or None.

    Grids finer than twice the modes, where a plain transform would cost more than it saves, do not count.
    """
    found: list[tuple[int, float]] = []
    for axis in range(places.shape[1]):
        u = np.unique(np.round(places[:, axis], 12))
        gaps = np.diff(np.append(u, u[0] + 1.0))
        gaps = gaps[gaps > 1e-3 / modes[axis]]
        step = float(gaps.min()) if gaps.size else 1.0
        best = None
        for count in dict.fromkeys((round(1.0 / step), modes[axis])):  # the coarser is cheaper
            if not 1 <= count <= 2 * modes[axis]:
                continue
            angle = np.angle(np.mean(np.exp(2j * np.pi * u * count))) / (2 * np.pi)
            off = u * count - angle
            if np.abs(off - np.round(off)).max() <= accuracy:
                best = (count, 0.0 if abs(angle) <= accuracy else float(angle))
                break
        if best is None:
            return None
        found.append(best)
    return found


def _literal(count: int) -> Ints:
    """Mode numbers in transform order, Nyquist as −N/2."""
    n = np.arange(count)
    return np.where(2 * n < count, n, n - count)


def gridded(
    places: NDArray[np.float64],
    scale: NDArray[np.float64],
    modes: tuple[int, int],
    grid: list[tuple[int, float]],
    dtype: str,
) -> Lateral:
    """Tables for sensors on the points of a grid (NER); several sensors on one point add up."""
    counts, shift = (grid[0][0], grid[1][0]), (grid[0][1], grid[1][1])
    cells = np.stack(
        [np.rint(places[:, a] * counts[a] - shift[a]).astype(np.int64) % counts[a] for a in (0, 1)], axis=1
    )
    entries = (cells[:, 0], cells[:, 1], np.arange(len(places)), np.ones(len(places)))
    spread = entries_spread(*entries, scale=scale, lines=counts[0], dtype=dtype)
    return _finish(counts, spread, modes, shift, (None, None))


def filled(
    places: NDArray[np.float64],
    cell_scale: float,
    modes: tuple[int, int],
    grid: list[tuple[int, float]],
    dtype: str,
) -> Lateral:
    """Tables for a grid filled linearly from the sensors; ``cell_scale`` is the weight of one grid point."""
    counts, shift = (grid[0][0], grid[1][0]), (grid[0][1], grid[1][1])
    scale = np.full(len(places), cell_scale)
    spread = entries_spread(*filling(places, counts, shift), scale=scale, lines=counts[0], dtype=dtype)
    return _finish(counts, spread, modes, shift, (None, None))


def entries_spread(
    lines_of: Ints,
    cells: Ints,
    sensors: Ints,
    weights: NDArray[np.float64],
    *,
    scale: NDArray[np.float64],
    lines: int,
    dtype: str,
) -> Spread:
    """Spread from a list of (line, cell, sensor, weight)."""
    order = np.lexsort((cells, lines_of))
    starts = np.searchsorted(lines_of[order], np.arange(lines + 1))
    one = np.ones((1, 1), dtype)
    return Spread(
        False,
        np.arange(len(scale)),
        scale.astype(dtype),
        starts.astype(np.int64),
        cells[order].astype(np.int64),
        sensors[order].astype(np.int64),
        one,
        np.ascontiguousarray(weights[order][:, None].astype(dtype)),
    )


def part(spread: Spread, sensors: Ints) -> Spread:
    """Spread of some of the sensors alone: for traces packed one a row in the order of ``sensors`` (each once)."""
    row = np.full(len(spread.scale), -1, np.int64)
    row[sensors] = np.arange(len(sensors))
    rows = row[spread.order] if spread.separable else row[spread.sensors]
    kept = rows >= 0
    starts = np.concatenate([[0], np.cumsum(kept)])[spread.starts].astype(np.int64)
    if spread.separable:
        return Spread(
            True,
            rows[kept],
            spread.scale[kept],
            starts,
            spread.first[kept],
            spread.sensors,
            np.ascontiguousarray(spread.wx[kept]),
            np.ascontiguousarray(spread.wy[kept]),
        )
    return Spread(
        False,
        np.arange(len(sensors)),
        spread.scale[sensors],
        starts,
        spread.first[kept],
        rows[kept],
        spread.wx,
        np.ascontiguousarray(spread.wy[kept]),
    )


def non_uniform(
    places: NDArray[np.float64],
    scale: NDArray[np.float64],
    modes: tuple[int, int],
    windows: tuple[Window | None, Window],
    sizes: tuple[int, int],
    dtype: str,
) -> Lateral:
    """Tables for sensors anywhere (NED)."""
    counts, first, taps = [], [], []
    for axis, window in enumerate(windows):
        if window is None:
            counts.append(1)
            first.append(np.zeros(len(places), np.int64))
            taps.append(np.ones((len(places), 1)))
            continue
        count = sizes[axis]
        left = places[:, axis] * count - window.width / 2
        whole = np.floor(left)
        counts.append(count)
        first.append((whole.astype(np.int64) + 1) % count)
        taps.append(window.taps(left - whole))
    order = np.lexsort((first[1], first[0]))
    spread = Spread(
        True,
        order.astype(np.int64),
        scale[order].astype(dtype),
        np.searchsorted(first[0][order], np.arange(counts[0] + 1)).astype(np.int64),
        first[1][order],
        np.zeros(1, np.int64),
        np.ascontiguousarray(taps[0][order].astype(dtype)),
        np.ascontiguousarray(np.pad(taps[1][order], ((0, 0), (0, taps[1].shape[1] % 2))).astype(dtype)),
    )
    return _finish((counts[0], counts[1]), spread, modes, (0.0, 0.0), windows)


def _finish(
    grid: tuple[int, int],
    spread: Spread,
    modes: tuple[int, int],
    shift: tuple[float, float],
    windows: tuple[Window | None, Window | None],
) -> Lateral:
    nx, ny = grid
    replicated = nx < modes[0] or ny < modes[1]
    stored = grid if replicated else modes
    jx, jy = _literal(stored[0]), _literal(stored[1])[: stored[1] // 2 + 1]
    edge_rows = np.full((len(jx), len(jy)), -1, np.int64)
    edge_swap = np.zeros(len(jy), np.bool_)
    edge_jx = jx.copy()
    if not replicated:
        if stored[0] % 2 == 0 and (nx != stored[0] or shift[0]):
            edge_rows[stored[0] // 2, :] = 0
            edge_jx[stored[0] // 2] = stored[0] // 2
        if stored[1] % 2 == 0 and (ny != stored[1] or shift[1]):
            edge_rows[:, stored[1] // 2] = 0
            edge_swap[stored[1] // 2] = True
        which = edge_rows >= 0
        edge_rows[which] = 2 * (len(jx) * len(jy) + np.arange(np.count_nonzero(which)))
    return Lateral(
        grid, spread, jx % nx, jy % ny, -jx % nx, -jy % ny, edge_jx % nx, -edge_jx % nx, edge_rows, edge_swap,
        replicated, shift, windows,
    )  # fmt: skip
