"""Poisson-disc sampling by Bridson's algorithm: random points with a minimum spacing."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from steradian.core.jit import jit

exact = partial(jit, fast=False)
"""Compile a loop that keeps to the order of sums, so that results are the same everywhere."""

TRIES = 30
"""Darts thrown around a point before it is given up."""


def sample_poisson_disc(spacing: float, seed: int) -> NDArray[np.float64]:
    """Return random points in the unit square at least ``spacing`` apart, that leave no gap.

    Returns
    -------
    ndarray
        (M, 2) within [0, 1), in the order found.
    """
    first = np.random.default_rng(seed)
    found: NDArray[np.float64] = _fill(float(spacing), int(first.integers(1, 2**63 - 1)))
    return found


@exact
def _uniform(state: NDArray[np.uint64]) -> float:
    """Return the next random number in [0, 1) of a xorshift* generator, identical on every machine."""
    value = state[0]
    value ^= value >> np.uint64(12)
    value ^= value << np.uint64(25)
    value ^= value >> np.uint64(27)
    state[0] = value
    return float((value * np.uint64(2685821657736338717)) >> np.uint64(11)) / 9007199254740992.0


@exact
def _fill(spacing: float, seed: int) -> NDArray[np.float64]:
    cells = max(1, int(np.ceil(np.sqrt(2.0) / spacing)))  # a cell of side spacing/√2 holds at most one point
    grid = np.full((cells, cells), -1, np.int32)
    most = int(1.2 * 0.7 / spacing**2) + 64
    points = np.empty((most, 2))
    active = np.empty(most, np.int32)
    state = np.array([seed], np.uint64)
    points[0, 0], points[0, 1] = _uniform(state), _uniform(state)
    grid[int(points[0, 0] * cells), int(points[0, 1] * cells)] = 0
    count, waiting = 1, 1
    active[0] = 0
    while waiting and count < most:
        pick = int(_uniform(state) * waiting)
        origin = active[pick]
        for attempt in range(TRIES):
            distance = spacing * np.sqrt(1 + 3 * _uniform(state))
            angle = 2 * np.pi * _uniform(state)
            x = points[origin, 0] + distance * np.cos(angle)
            y = points[origin, 1] + distance * np.sin(angle)
            if 0 <= x < 1 and 0 <= y < 1 and _is_valid(x, y, spacing, cells, grid, points):
                points[count, 0], points[count, 1] = x, y
                grid[int(x * cells), int(y * cells)] = count
                active[waiting] = count
                count, waiting = count + 1, waiting + 1
                break
            if attempt == TRIES - 1:
                waiting -= 1
                active[pick] = active[waiting]
    return points[:count].copy()


@exact
def _is_valid(
    x: float, y: float, spacing: float, cells: int, grid: NDArray[np.int32], points: NDArray[np.float64]
) -> bool:
    column, row = int(x * cells), int(y * cells)
    for i in range(max(0, column - 2), min(cells, column + 3)):
        for j in range(max(0, row - 2), min(cells, row + 3)):
            other = grid[i, j]
            if other >= 0 and (points[other, 0] - x) ** 2 + (points[other, 1] - y) ** 2 < spacing**2:
                return False
    return True
