"""Short ways through points: nearest neighbour, then 2-opt and Or-opt, in bounded time and memory.

Each point knows only its few nearest neighbours, so memory grows with M and not with M². Time is bounded by a budget
of elementary steps, not by a clock: the same points always give the same order.
"""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np
from numpy.typing import NDArray

from steradian.plans.curves import hilbert

NEIGHBOURS = 8
BUDGET = 400_000_000
"""Elementary steps of one optimisation, about a second's work."""
LONGEST = 50_000
"""No move turns round more points than this."""
BOTH = 60_000
"""Up to so many points, two beginnings are improved and the better kept; beyond, only the quicker one."""


def shortest(positions: NDArray[np.float64]) -> NDArray[np.int64]:
    """Visit points (M, 2) on a short way, open at both ends.

    Returns
    -------
    ndarray
        (M,) indices.
    """
    if len(positions) < 4:
        return hilbert(positions)
    neighbours, curve = nearest(positions, NEIGHBOURS), hilbert(positions)
    starts = [curve]
    if len(positions) <= BOTH:
        starts.append(_nearest_neighbour(positions, neighbours, curve))
    tours = [_improve(positions, neighbours, start, BUDGET, LONGEST) for start in starts]
    best: NDArray[np.int64] = min(tours, key=lambda tour: _open_length(positions, tour))
    return best


def nearest_neighbour(positions: NDArray[np.float64]) -> NDArray[np.int64]:
    """Go to the nearest point not yet visited, again and again (where all near ones are visited: along a curve)."""
    if len(positions) < 4:
        return hilbert(positions)
    tour: NDArray[np.int64] = _nearest_neighbour(positions, nearest(positions, NEIGHBOURS), hilbert(positions))
    return tour


def join(positions: NDArray[np.float64], pieces: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Put tours one after the other, turning those round that then start closer to where the last one ended."""
    joined = [pieces[0]]
    for piece in pieces[1:]:
        here = positions[joined[-1][-1]]
        ends = np.linalg.norm(positions[piece[[0, -1]]] - here, axis=1)
        joined.append(piece if ends[0] <= ends[1] else piece[::-1])
    return np.concatenate(joined)


def nearest(positions: NDArray[np.float64], count: int) -> NDArray[np.int32]:
    """Nearest neighbours (M, K) of each point, closest first; K is ``count`` where there are so many."""
    from scipy.spatial import KDTree

    count = min(count, len(positions) - 1)
    found = np.asarray(KDTree(positions).query(positions, k=count + 1)[1]).astype(np.int32)
    # a point is not always the first of its own neighbours where others lie at the same place
    own = found == np.arange(len(positions), dtype=np.int32)[:, None]
    own[~own.any(axis=1), -1] = True
    others: NDArray[np.int32] = found[~own].reshape(len(positions), count)
    return others


def _open_length(positions: NDArray[np.float64], tour: NDArray[np.int64]) -> float:
    return float(np.linalg.norm(np.diff(positions[tour], axis=0), axis=1).sum())


@numba.njit(cache=True)
def _apart(positions: NDArray[np.float64], a: int, b: int) -> float:
    return float(np.hypot(positions[a, 0] - positions[b, 0], positions[a, 1] - positions[b, 1]))


@numba.njit(cache=True)
def _nearest_neighbour(
    positions: NDArray[np.float64], neighbours: NDArray[np.int32], curve: NDArray[np.int64]
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
                    distance = _apart(positions, here, left)
                    if distance < least:
                        chosen, least = left, distance
                    left = before[left]
                if right >= 0:
                    distance = _apart(positions, here, right)
                    if distance < least:
                        chosen, least = right, distance
                    right = after[right]
        here = chosen
    return tour


@numba.njit(cache=True)
def _length(positions: NDArray[np.float64], a: int, b: int) -> float:
    """Distance of two points; the helper node after the last, which joins the tour's open ends, is near to all."""
    if a == len(positions) or b == len(positions):
        return 0.0
    return _apart(positions, a, b)


@numba.njit(cache=True)
def _reverse(tour: NDArray[np.int64], place: NDArray[np.int64], first: int, last: int) -> int:
    """Turn round the part of a closed tour from place ``first`` to ``last``; return its length."""
    size = len(tour)
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


@numba.njit(cache=True)
def _two_opt(
    positions: NDArray[np.float64],
    neighbours: NDArray[np.int32],
    tour: NDArray[np.int64],
    place: NDArray[np.int64],
    a: int,
    longest: int,
) -> int:
    """Try to replace an edge at ``a`` and another by two shorter ones; return the steps taken, 0 for no gain."""
    size = len(tour)
    for direction in (1, -1):
        b = tour[(place[a] + direction) % size]
        old = _length(positions, a, b)
        for c in neighbours[a]:
            first = _apart(positions, a, c)
            if first >= old:
                break
            d = tour[(place[c] + direction) % size]
            gain = old + _length(positions, c, d) - first - _length(positions, b, d)
            if gain > 1e-12:
                start, end = (place[b], place[c]) if direction == 1 else (place[c], place[b])
                inside = (end - start) % size + 1
                if 2 * inside > size:  # turning round the rest makes the same closed tour
                    start, end, inside = (end + 1) % size, (start - 1) % size, size - inside
                if inside <= longest:
                    return 1 + int(_reverse(tour, place, start, end))
    return 0


@numba.njit(cache=True)
def _or_opt(
    positions: NDArray[np.float64],
    neighbours: NDArray[np.int32],
    tour: NDArray[np.int64],
    place: NDArray[np.int64],
    a: int,
    longest: int,
) -> int:
    """Try to move a piece of up to three points, ending with ``a``, between ``a``'s neighbour c and one beside it."""
    size = len(tour)
    for direction in (1, -1):
        for length in range(1, 4):
            # the piece runs from a back to z; p and n are what it lies between
            z = tour[(place[a] - direction * (length - 1)) % size]
            n = tour[(place[a] + direction) % size]
            p = tour[(place[z] - direction) % size]
            removed = _length(positions, p, z) + _length(positions, a, n) - _length(positions, p, n)
            if removed <= 1e-12:
                continue
            for c in neighbours[a]:
                near = _apart(positions, a, c)
                if near >= removed:
                    break
                ahead = (direction * (place[c] - place[a])) % size  # places from a to c, going away from the piece
                if ahead == 0 or ahead > size - length:
                    continue  # c is in the piece
                for side in (1, -1):
                    e = tour[(place[c] + side * direction) % size]
                    if e == a or e == z:
                        continue
                    gain = removed + _length(positions, c, e) - near - _length(positions, z, e)
                    if gain <= 1e-12:
                        continue
                    steps = _move_piece(tour, place, z, a, n, p, c, e, direction, side, longest)
                    if steps:
                        return int(steps)
    return 0


@numba.njit(cache=True)
def _move_piece(
    tour: NDArray[np.int64],
    place: NDArray[np.int64],
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
    """Move z…a between c and e by turning parts round; return the steps, 0 if that would be too many.

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
        _turn(tour, place, z, near, direction)
        _turn(tour, place, near, n, direction)
        if side == -1:  # the piece must lie z…a before c, and it lies a…z
            _turn(tour, place, a, z, direction)
        return 1 + 2 * int(ahead)
    _turn(tour, place, far, a, direction)
    _turn(tour, place, p, far, direction)
    if side == -1:
        _turn(tour, place, a, z, direction)
    return 1 + 2 * int(behind)


@numba.njit(cache=True)
def _turn(tour: NDArray[np.int64], place: NDArray[np.int64], first: int, last: int, direction: int) -> None:
    """Turn round the part from point ``first`` to point ``last``, as seen in ``direction``."""
    if direction == 1:
        _reverse(tour, place, place[first], place[last])
    else:
        _reverse(tour, place, place[last], place[first])


@numba.njit(cache=True)
def _improve(
    positions: NDArray[np.float64], neighbours: NDArray[np.int32], start: NDArray[np.int64], budget: int, longest: int
) -> NDArray[np.int64]:
    """Apply gaining moves until there are none or the budget is spent."""
    count = len(start)
    size = count + 1
    tour, place = np.empty(size, np.int64), np.empty(size, np.int64)
    tour[:count], tour[count] = start, count
    for step in range(size):
        place[tour[step]] = step

    waiting, queued = np.empty(size, np.int64), np.ones(count, np.bool_)
    waiting[:count] = start
    head, filled = 0, count
    while filled and budget > 0:
        a = waiting[head]
        head = (head + 1) % size
        filled -= 1
        queued[a] = False
        here = place[a]
        around = (tour[here - 1], tour[(here + 1) % size])
        steps = _two_opt(positions, neighbours, tour, place, a, longest)
        if not steps:
            steps = _or_opt(positions, neighbours, tour, place, a, longest)
        budget -= 40 + steps
        if steps:  # all points at the ends of edges that changed, and more, have another look
            here = place[a]
            for point in (a, around[0], around[1], tour[here - 1], tour[(here + 1) % size]):
                for beside in range(-1, 2):
                    again = tour[(place[point] + beside) % size]
                    if again < count and not queued[again]:
                        queued[again] = True
                        waiting[(head + filled) % size] = again
                        filled += 1
    first = place[count]
    found = np.empty(count, np.int64)
    for step in range(count):
        found[step] = tour[(first + 1 + step) % size]
    return found
