"""Short tours through points: nearest neighbour, then 2-opt and Or-opt, in bounded time and memory.

Each point knows only its few nearest neighbours, so memory grows with M and not with M². Time is bounded by a budget
of elementary steps, not by a clock: the same points always give the same order.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.plans.curve_orders import hilbert
from steradian.plans.local_search import distance, exact, length, or_opt, reverse, reverse_segment, two_opt

NEIGHBOURS = 8
BUDGET = 400_000_000
"""Elementary steps until no move gains, about a second's work; usually far fewer are needed."""
MAX_KICKS = 2_000
"""So often, at most, the finished way is disturbed in one place and mended, and the change kept if that was a gain …"""
KICKS_PER_POINT = 2
"""… and at most so often for each point."""
LONGEST = 50_000
"""No move turns round more points than this."""
BOTH = 60_000
"""Up to so many points, two beginnings are improved and the better kept; beyond, only the shorter one is."""


def short_tour(positions: NDArray[np.float64], kicks: int = MAX_KICKS) -> NDArray[np.int64]:
    """Return a short open tour of points (M, 2) by iterated local search with at most ``kicks`` perturbations.

    Returns
    -------
    ndarray
        (M,) indices.
    """
    if len(positions) < 4:
        return hilbert(positions)
    neighbours, curve = nearest(positions, NEIGHBOURS), hilbert(positions)
    starts = [_nearest_neighbour(positions, neighbours, curve), curve]
    if len(positions) > BOTH:
        starts = [min(starts, key=lambda tour: _open_length(positions, tour))]
    kicks = min(kicks, KICKS_PER_POINT * len(positions))
    tours = [_improve(positions, neighbours, start, BUDGET, LONGEST, kicks) for start in starts]
    best: NDArray[np.int64] = min(tours, key=lambda tour: _open_length(positions, tour))
    return best


def nearest_neighbour(positions: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the nearest-neighbour tour; without unvisited neighbours, the next point on a Hilbert curve."""
    if len(positions) < 4:
        return hilbert(positions)
    tour: NDArray[np.int64] = _nearest_neighbour(positions, nearest(positions, NEIGHBOURS), hilbert(positions))
    return tour


def tour_by_group(positions: NDArray[np.float64], group: NDArray[Any]) -> NDArray[np.int64]:
    """Return a tour of points (M, 2) by ascending group (M,), each on a short tour; the groups share the kicks."""
    ranked = np.argsort(group, kind="stable")
    pieces = np.split(ranked, np.flatnonzero(np.diff(group[ranked])) + 1)
    share = MAX_KICKS / len(positions)
    return concatenate(positions, [piece[short_tour(positions[piece], round(share * len(piece)))] for piece in pieces])


def concatenate(positions: NDArray[np.float64], pieces: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Concatenate tours, reversing those that then start closer to the previous end."""
    joined = [pieces[0]]
    for piece in pieces[1:]:
        here = positions[joined[-1][-1]]
        ends = np.linalg.norm(positions[piece[[0, -1]]] - here, axis=1)
        joined.append(piece if ends[0] <= ends[1] else piece[::-1])
    return np.concatenate(joined)


def nearest(positions: NDArray[np.float64], count: int) -> NDArray[np.int64]:
    """Return the nearest neighbours (M, K) of each point, closest first; K is at most ``count``."""
    from scipy.spatial import KDTree

    count = min(count, len(positions) - 1)
    found = np.asarray(KDTree(positions).query(positions, k=count + 1)[1]).astype(np.int64)
    # a point is not always the first of its own neighbours where others lie at the same place
    own = found == np.arange(len(positions))[:, None]
    own[~own.any(axis=1), -1] = True
    others: NDArray[np.int64] = found[~own].reshape(len(positions), count)
    return others


def _open_length(positions: NDArray[np.float64], tour: NDArray[np.int64]) -> float:
    return float(np.linalg.norm(np.diff(positions[tour], axis=0), axis=1).sum())


@exact
def _nearest_neighbour(
    positions: NDArray[np.float64], neighbours: NDArray[np.int64], curve: NDArray[np.int64]
) -> NDArray[np.int64]:
    count = len(positions)
    before, after = np.empty(count, np.int64), np.empty(count, np.int64)  # the unvisited, along the curve
    for place in range(count):
        before[curve[place]] = curve[place - 1] if place else -1
        after[curve[place]] = curve[place + 1] if place + 1 < count else -1
    visited = np.zeros(count, np.bool_)
    tour = np.empty(count, np.int64)
    here = curve[0]
    for step in range(count):
        tour[step] = here
        visited[here] = True
        left, right = before[here], after[here]
        if left >= 0:
            after[left] = right
        if right >= 0:
            before[right] = left
        chosen, least = -1, np.inf
        for near in neighbours[here]:
            if not visited[near]:
                chosen = near
                break
        if chosen < 0:
            for _ in range(64):
                if left >= 0:
                    length = distance(positions, here, left)
                    if length < least:
                        chosen, least = left, length
                    left = before[left]
                if right >= 0:
                    length = distance(positions, here, right)
                    if length < least:
                        chosen, least = right, length
                    right = after[right]
        here = chosen
    return tour


@exact
def _local_search(
    positions: NDArray[np.float64],
    neighbours: NDArray[np.int64],
    tour: NDArray[np.int64],
    place: NDArray[np.int64],
    log: NDArray[np.int64],
    gained: NDArray[np.float64],
    waiting: NDArray[np.int64],
    filled: int,
    queued: NDArray[np.bool_],
    budget: int,
    longest: int,
) -> None:
    """Apply improving moves at the ``filled`` points in ``waiting`` and their neighbours until none improves."""
    size, head = len(tour), 0
    while filled:
        a = waiting[head]
        head = (head + 1) % size
        filled -= 1
        queued[a] = False
        if budget < 0:
            continue
        here = place[a]
        around = (tour[here - 1], tour[(here + 1) % size])
        steps = two_opt(positions, neighbours, tour, place, log, gained, a, longest)
        if not steps:
            steps = or_opt(positions, neighbours, tour, place, log, gained, a, longest)
        budget -= 40 + steps
        if steps:  # all points at the ends of edges that changed, and more, have another look
            here = place[a]
            for point in (a, around[0], around[1], tour[here - 1], tour[(here + 1) % size]):
                for beside in range(-1, 2):
                    again = tour[(place[point] + beside) % size]
                    if again < size - 1 and not queued[again]:
                        queued[again] = True
                        waiting[(head + filled) % size] = again
                        filled += 1


@exact
def _perturb(
    positions: NDArray[np.float64],
    tour: NDArray[np.int64],
    place: NDArray[np.int64],
    log: NDArray[np.int64],
    gained: NDArray[np.float64],
    waiting: NDArray[np.int64],
    queued: NDArray[np.bool_],
) -> int:
    """Exchange two adjacent segments of up to 30 points at a random place; return the number of affected ends."""
    size = len(tour)
    span = min(30, (size - 2) // 2)
    first = np.random.randint(0, size)  # noqa: NPY002 - numba's own generator, seeded by the caller
    one, two = np.random.randint(1, span + 1), np.random.randint(1, span + 1)  # noqa: NPY002
    middle, last = (first + one - 1) % size, (first + one + two - 1) % size
    p, a, b = tour[first - 1], tour[first], tour[middle]
    c, d, n = tour[(middle + 1) % size], tour[last], tour[(last + 1) % size]
    gained[0] += length(positions, p, a) + length(positions, b, c) + length(positions, d, n)
    gained[0] -= length(positions, p, c) + length(positions, d, a) + length(positions, b, n)
    onward = np.int64(1)
    reverse_segment(tour, place, log, a, d, onward)
    reverse_segment(tour, place, log, d, c, onward)
    reverse_segment(tour, place, log, b, a, onward)
    filled = 0
    for point in (p, a, b, c, d, n):
        if point < size - 1 and not queued[point]:
            queued[point] = True
            waiting[filled] = point
            filled += 1
    return filled


@exact
def _improve(
    positions: NDArray[np.float64],
    neighbours: NDArray[np.int64],
    start: NDArray[np.int64],
    budget: int,
    longest: int,
    kicks: int,
) -> NDArray[np.int64]:
    """Improve a tour by iterated local search: local optimum, then perturbation and repair."""
    count = len(start)
    size = count + 1
    tour, place = np.empty(size, np.int64), np.empty(size, np.int64)
    tour[:count], tour[count] = start, count
    for step in range(size):
        place[tour[step]] = step
    waiting, queued = np.empty(size, np.int64), np.ones(count, np.bool_)
    waiting[:count] = start
    log, gained = np.zeros((1000, 2), np.int64), np.zeros(1)
    _local_search(positions, neighbours, tour, place, log, gained, waiting, count, queued, budget, longest)
    np.random.seed(1)  # noqa: NPY002
    steps, far = np.int64(100_000), np.int64(1000)  # literals would be compiled for once more
    for _ in range(kicks if count >= 8 else 0):
        log[0, 0], gained[0] = 0, 0.0
        filled = _perturb(positions, tour, place, log, gained, waiting, queued)
        _local_search(positions, neighbours, tour, place, log, gained, waiting, filled, queued, steps, far)
        if gained[0] < 0 and log[0, 0] < len(log):
            for entry in range(log[0, 0], 0, -1):
                first, last = log[entry, 0], log[entry, 1]
                reverse(tour, place, log, first, last)
    first = place[count]
    found = np.empty(count, np.int64)
    for step in range(count):
        found[step] = tour[(first + 1 + step) % size]
    return found
