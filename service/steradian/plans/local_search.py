"""Local search for short tours by 2-opt and Or-opt moves on an array.

The tour has one node more than there are points. It is near to all, so that a closed tour through it is a way with two
open ends. Everything is done by turning parts round, noted in a log, so that it can be undone.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from steradian.core.jit import jit

exact = partial(jit, fast=False)
"""Compile a loop that keeps to the order of sums, so that results are the same everywhere."""


@exact
def distance(positions: NDArray[np.float64], a: int, b: int) -> float:
    """Return the Euclidean distance of two points."""
    return float(np.hypot(positions[a, 0] - positions[b, 0], positions[a, 1] - positions[b, 1]))


@exact
def length(positions: NDArray[np.float64], a: int, b: int) -> float:
    """Return the distance of two nodes; the auxiliary node of open tours has distance 0 to all."""
    if a == len(positions) or b == len(positions):
        return 0.0
    return float(distance(positions, a, b))


@exact
def reverse(tour: NDArray[np.int64], place: NDArray[np.int64], log: NDArray[np.int64], first: int, last: int) -> int:
    """Reverse the segment of a closed tour from index ``first`` to ``last``; return its length.

    The log's first row counts, the others are what was turned round, so that it can be undone.
    """
    size = len(tour)
    log[0, 0] += 1
    if log[0, 0] < len(log):
        log[log[0, 0], 0], log[log[0, 0], 1] = first, last
    inside = (last - first) % size + 1
    for _ in range(inside // 2):
        a, b = tour[first], tour[last]
        tour[first], place[b] = b, first
        tour[last], place[a] = a, last
        first, last = first + 1, last - 1
        if first == size:
            first = 0
        if last < 0:
            last = size - 1
    return inside


@exact
def two_opt(
    positions: NDArray[np.float64],
    neighbours: NDArray[np.int64],
    tour: NDArray[np.int64],
    place: NDArray[np.int64],
    log: NDArray[np.int64],
    gained: NDArray[np.float64],
    a: int,
    longest: int,
) -> int:
    """Try a 2-opt move: replace the edge at ``a`` and another by two shorter ones; return the steps, 0 if no gain."""
    size = len(tour)
    for direction in (1, -1):
        b = tour[(place[a] + direction) % size]
        old = length(positions, a, b)
        for c in neighbours[a]:
            first = distance(positions, a, c)
            if first >= old:
                break
            d = tour[(place[c] + direction) % size]
            gain = old + length(positions, c, d) - first - length(positions, b, d)
            if gain > 1e-12:
                start, end = (place[b], place[c]) if direction == 1 else (place[c], place[b])
                inside = (end - start) % size + 1
                if 2 * inside > size:  # turning round the rest makes the same closed tour
                    start, end, inside = (end + 1) % size, (start - 1) % size, size - inside
                if inside <= longest:
                    gained[0] += gain
                    return 1 + int(reverse(tour, place, log, start, end))
    return 0


@exact
def or_opt(
    positions: NDArray[np.float64],
    neighbours: NDArray[np.int64],
    tour: NDArray[np.int64],
    place: NDArray[np.int64],
    log: NDArray[np.int64],
    gained: NDArray[np.float64],
    a: int,
    longest: int,
) -> int:
    """Try an Or-opt move: move a segment of up to three points ending with ``a`` between neighbour c and the next."""
    size = len(tour)
    for direction in (1, -1):
        for points in range(1, 4):
            # the piece runs from a back to z; p and n are what it lies between
            z = tour[(place[a] - direction * (points - 1)) % size]
            n = tour[(place[a] + direction) % size]
            p = tour[(place[z] - direction) % size]
            removed = length(positions, p, z) + length(positions, a, n) - length(positions, p, n)
            if removed <= 1e-12:
                continue
            for c in neighbours[a]:
                near = distance(positions, a, c)
                if near >= removed:
                    break
                ahead = (direction * (place[c] - place[a])) % size  # places from a to c, going away from the piece
                if ahead == 0 or ahead > size - points:
                    continue  # c is in the piece
                for side in (1, -1):
                    e = tour[(place[c] + side * direction) % size]
                    if e == a or e == z:
                        continue
                    gain = removed + length(positions, c, e) - near - length(positions, z, e)
                    if gain <= 1e-12:
                        continue
                    steps = move_segment(tour, place, log, z, a, n, p, c, e, direction, side, longest)
                    if steps:
                        gained[0] += gain
                        return int(steps)
    return 0


@exact
def move_segment(
    tour: NDArray[np.int64],
    place: NDArray[np.int64],
    log: NDArray[np.int64],
    z: int,
    a: int,
    n: int,
    p: int,
    c: int,
    e: int,
    direction: int,
    side: int,
    longest: int,
) -> int:
    """Move segment z…a between c and e by reversals; return the steps, 0 if that would be too many.

    Seen in ``direction``: p z…a n … (c e | e c) becomes p n … c a…z e or p n … e z…a c.
    """
    size = len(tour)
    far = e if side == 1 else c  # the one of c, e that comes later
    near = c if side == 1 else e
    ahead = (direction * (place[near] - place[a])) % size
    behind = (direction * (place[z] - place[far])) % size
    if min(ahead, behind) > longest:
        return 0
    if ahead <= behind:
        # turn round z … near, then n … near (now first) back
        reverse_segment(tour, place, log, z, near, direction)
        reverse_segment(tour, place, log, near, n, direction)
        if side == -1:  # the piece must lie z…a before c, and it lies a…z
            reverse_segment(tour, place, log, a, z, direction)
        return 1 + 2 * int(ahead)
    reverse_segment(tour, place, log, far, a, direction)
    reverse_segment(tour, place, log, p, far, direction)
    if side == -1:
        reverse_segment(tour, place, log, a, z, direction)
    return 1 + 2 * int(behind)


@exact
def reverse_segment(
    tour: NDArray[np.int64], place: NDArray[np.int64], log: NDArray[np.int64], first: int, last: int, direction: int
) -> None:
    """Reverse the segment from point ``first`` to point ``last``, as seen in ``direction``."""
    if direction == 1:
        reverse(tour, place, log, place[first], place[last])
    else:
        reverse(tour, place, log, place[last], place[first])
