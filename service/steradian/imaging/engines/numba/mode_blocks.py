"""Grouping of lateral modes into SIMD blocks for the time-to-depth step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from steradian.imaging.engines.numba.kernel_args import StoredModes
from steradian.imaging.transform_tables import TransformTables
from steradian.imaging.transforms.lateral import LateralTransform
from steradian.imaging.volume import RealArray

Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class ModeBlocks:
    """Tables of B blocks of 16 modes for the time-to-depth kernels (:mod:`.depth`).

    Parameters
    ----------
    source, target
        Rows of the real parts, shape (B, 16); the imaginary part is the next row. −1: lane not in use.
    factors
        Shape (B, 64): what a source column a + ib becomes is (f0·a + f1·b) + i(f2·a + f3·b), 16 lanes each.
    squares
        |j|² in units of κ², shape (B, 4), or (B, 8) for groups of 2, (B, 16) for groups of 1.
    edges
        Pairs of lanes, of which the even one is read at −N/2 for κ > 0 and the odd one at +N/2 for κ < 0; true for
        groups of such pairs (of groups of 1 for the odd one). Shape as ``squares``.
    """

    source: Ints
    target: Ints
    factors: RealArray
    squares: NDArray[np.float64]
    edges: NDArray[np.bool_]


def group_modes(tables: TransformTables, stored: StoredModes) -> ModeBlocks:
    """Group lateral modes of equal |j| into blocks of 16 SIMD lanes."""
    lateral, scales, modes = tables.lateral, tables.rule.scales, tables.lateral.modes
    half = modes[1] // 2 + 1
    i, k = (v.ravel() for v in np.meshgrid(np.arange(modes[0]), np.arange(half), indexing="ij"))
    # mode numbers with Nyquist at −N/2 (for κ > 0) and at +N/2 (for κ < 0)
    jx, jy = np.where(2 * i < modes[0], i, i - modes[0]), np.where(2 * k < modes[1], k, k - modes[1])
    px, py = np.where(2 * i == modes[0], i, jx), np.where(2 * k == modes[1], k, jy)
    column = k * modes[0] + i
    if lateral.replicated:
        edge = ((jx != px) & (lateral.shift[0] != 0)) | ((jy != py) & (lateral.shift[1] != 0))
        minus, plus = _folded(lateral, jx, jy), _folded(lateral, px, py)
    else:
        rows = stored.edge_rows[i, k]
        edge = rows >= 0
        same = np.ones(len(i), np.bool_)
        minus, plus = (2 * column, same), (np.where(edge, rows, 2 * column), same)
    square = (scales[0] * jx) ** 2 + (scales[1] * jy) ** 2
    level = np.round(square / max(float(square.max()), 1e-300) * 2**44).astype(np.int64)

    # lanes: one a plain mode, two a mode with an edge copy
    lane_mode = np.concatenate([np.flatnonzero(~edge), np.repeat(np.flatnonzero(edge), 2)])
    copy = np.concatenate([np.zeros(np.count_nonzero(~edge), np.int64), np.tile([0, 1], np.count_nonzero(edge))])
    order = np.lexsort((copy, lane_mode, edge[lane_mode], level[lane_mode]))
    lane_mode, copy = lane_mode[order], copy[order]
    new = np.ones(len(lane_mode), np.bool_)
    new[1:] = (np.diff(level[lane_mode]) != 0) | (np.diff(edge[lane_mode].astype(np.int8)) != 0)
    run_start = np.flatnonzero(new)
    run_length = np.diff(np.append(run_start, len(lane_mode)))
    # on a square aperture ±x, ±y and their exchange are alike; the half-plane holds four of these eight
    lanes = 1 if modes[0] == 1 else 4 if np.isclose(scales[0], scales[1], rtol=1e-9) else 2
    groups_before = np.concatenate([[0], np.cumsum(-(-run_length // lanes))])
    if lanes == 1 and edge.any():
        groups_before[-2:] += groups_before[-2] % 2  # the only pair, N/2, is the last run: it begins at an even lane
    run = np.cumsum(new) - 1
    place = groups_before[run] * lanes + np.arange(len(lane_mode)) - run_start[run]

    count = -(-int(groups_before[-1]) * lanes // 16)
    source, target = np.full(count * 16, -1, np.int64), np.full(count * 16, -1, np.int64)
    source[place] = np.where(copy == 0, minus[0][lane_mode], plus[0][lane_mode])
    target[place] = np.where(copy == 0, 2 * column[lane_mode], -1)
    straight = np.where(copy == 0, minus[1][lane_mode], plus[1][lane_mode])
    number = [np.where(copy == 0, a[lane_mode], b[lane_mode]) for a, b in ((jx, px), (jy, py))]
    # one half as the two halves of the spectrum are left added up
    norm = 0.5 / (modes[0] * modes[1] * tables.spectrum_length)
    factor = norm * lateral.factor(0, number[0]) * lateral.factor(1, number[1])
    if tables.transposable:
        factor[(2 * np.abs(number[0]) == modes[0]) | (2 * np.abs(number[1]) == modes[1])] = 0
    sign = np.where(straight, 1.0, -1.0)
    parts = np.zeros((4, count * 16))
    parts[:, place] = factor.real, -sign * factor.imag, factor.imag, sign * factor.real
    squares, edges = np.zeros(count * 16 // lanes), np.zeros(count * 16 // lanes, np.bool_)
    squares[place // lanes] = square[lane_mode]
    edges[place // lanes] = edge[lane_mode] & ((copy == 1) | (lanes > 1))
    return ModeBlocks(
        source.reshape(count, 16),
        target.reshape(count, 16),
        np.ascontiguousarray(parts.reshape(4, count, 16).transpose(1, 0, 2).reshape(count, 64).astype(tables.dtype)),
        squares.reshape(count, -1),
        edges.reshape(count, -1),
    )


def _folded(lateral: LateralTransform, jx: Ints, jy: Ints) -> tuple[Ints, NDArray[np.bool_]]:
    """Return each mode's row in the coarser grid's stored half, and whether it is the mode or its conjugate."""
    nx, ny = lateral.grid
    a, b = jx % nx, jy % ny
    straight = b <= ny // 2
    a, b = np.where(straight, a, -jx % nx), np.where(straight, b, ny - b)
    return 2 * (b * nx + a), straight
