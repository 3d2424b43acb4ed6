"""Sample elimination: repeated removal of the most crowded point."""

from __future__ import annotations

import heapq
from functools import partial

import numpy as np
from numpy.typing import NDArray

from steradian.core.jit import jit

exact = partial(jit, fast=False)
"""Compile a loop that keeps to the order of sums, so that results are the same everywhere."""


@exact
def eliminate_samples(
    starts: NDArray[np.int64], neighbours: NDArray[np.int64], crowding: NDArray[np.float64], wanted: int
) -> NDArray[np.bool_]:
    """Remove the most crowded points until ``count`` remain (weighted sample elimination).

    Parameters
    ----------
    starts
        (M + 1,) where each point's neighbours start in the two arrays that follow.
    neighbours, crowding
        (P,) neighbours and how much each adds to a point's crowding.
    wanted
        How many points shall be left.

    Returns
    -------
    ndarray
        (M,) whether a point is left.
    """
    count = len(starts) - 1
    total = np.zeros(count)
    for point in range(count):
        for entry in range(starts[point], starts[point + 1]):
            total[point] += crowding[entry]
    left = np.ones(count, np.bool_)
    heap = [(-total[point], point) for point in range(count)]
    heapq.heapify(heap)
    remaining = count
    while remaining > wanted:
        value, point = heapq.heappop(heap)
        if not left[point]:
            continue
        if -value > total[point] + 1e-12:  # it is less crowded by now
            heapq.heappush(heap, (-total[point], point))
            continue
        left[point] = False
        remaining -= 1
        for entry in range(starts[point], starts[point + 1]):
            total[neighbours[entry]] -= crowding[entry]
    return left
