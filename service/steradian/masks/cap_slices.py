"""Division of a spherical cap into slices with equal solid angle per point."""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, cos, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

SPIRAL_OFFSET = 1.8
"""A slice's number of points doubles while its chord exceeds this times the distance to the slice before."""


@dataclass(frozen=True)
class Slices:
    """Slices (rings) of a spherical cap, from the pole to the rim.

    Attributes
    ----------
    angles
        (K,) polar angle of each slice's points in radians; the first is 0.
    counts
        (K,) number of points of each, powers of two.
    """

    angles: tuple[float, ...]
    counts: tuple[int, ...]

    @property
    def total(self) -> int:
        """Total number of points of all slices."""
        return sum(self.counts)

    def azimuths(self, slices: int | None = None) -> list[NDArray[np.float64]]:
        """Return the azimuths in radians of the (first) slices' points, each slice offset by half a step."""
        found, turn = [], 0.0
        for count in self.counts[:slices]:
            azimuth = 2 * pi * np.arange(count) / count + pi / count + turn
            found.append(azimuth)
            turn = float(azimuth[-1]) % (2 * pi)
        return found

    def project(self, depth: float) -> NDArray[np.float64]:
        """Return the projection of the points to the sensor plane, (M, 2) in metres from the pole's foot."""
        pieces = [
            depth * np.tan(angle) * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
            for angle, azimuth in zip(self.angles, self.azimuths(), strict=True)
        ]
        return np.concatenate(pieces)


def slice_cap(rim: float, count: int) -> Slices:
    """Divide a cap into slices of units of 1/``count`` of its solid angle, from the pole, until all are used.

    The outer polar angle of a slice follows from unit · j = 2π (cos θ_inner − cos θ_outer); its points sit at the
    mid angle. The last slice may end beyond the rim; where it ends on the rim the count is convenient.

    Parameters
    ----------
    rim
        Polar angle θ_max of the cap's rim in radians.
    count
        Number of units.
    """
    unit = (1 - cos(rim)) / count  # in units of 2π
    angles, counts = [0.0], [1]
    total, number = 1, 2  # a slice of one has no neighbours to measure a chord between
    cosine = 1 - unit
    while total < count:
        while True:
            outer = max(cosine - unit * number, -1.0)
            angle = (acos(cosine) + acos(outer)) / 2
            if _chord(angle, number) <= SPIRAL_OFFSET * _nearest(angle, angles[-1], number):
                break
            number *= 2
        angles.append(angle)
        counts.append(number)
        total += number
        cosine = outer
    return Slices(tuple(angles), tuple(counts))


def convenient_slices(rim: float, count: int) -> Slices:
    """Divide a cap into the smallest convenient count ≥ ``count``: the last slice ends on the rim."""
    while True:
        reached = slice_cap(rim, count).total
        found = _convenient_within(rim, range(count, reached + 1))
        if found is not None:
            return found
        count = reached + 1


def convenient_below(rim: float, count: int) -> Slices | None:
    """Divide a cap into the largest convenient count below ``count``; ``None`` if there is none of at least 5."""
    stop = count
    while stop > 5:
        start = max(5, stop - slice_cap(rim, stop - 1).counts[-1])
        found = _convenient_within(rim, range(start, stop)[::-1])
        if found is not None:
            return found
        stop = start
    return None


def _convenient_within(rim: float, counts: range) -> Slices | None:
    """Find the first convenient count in a range by bisection."""
    first, last = slice_cap(rim, counts[0]), slice_cap(rim, counts[-1])
    if first.total == counts[0]:
        return first
    if first.counts == last.counts or len(counts) <= 2:
        return last if last.total == counts[-1] else None
    middle = len(counts) // 2
    return _convenient_within(rim, counts[:middle]) or _convenient_within(rim, counts[middle:])


def _chord(angle: float, count: int) -> float:
    """Return the distance between neighbouring points of a slice on the unit sphere."""
    return 2 * sin(angle) * sin(pi / count)


def _nearest(angle: float, inner: float, count: int) -> float:
    """Return the distance on the unit sphere to the closest point of the previous slice, π/count off in azimuth."""
    along = cos(angle) * cos(inner) + sin(angle) * sin(inner) * cos(pi / count)
    return sqrt(max(0.0, 2 - 2 * along))
