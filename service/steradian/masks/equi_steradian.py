"""Equi-steradian masks: each point covers the same solid angle seen from the point of interest (paper, appendix A)."""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, atan, ceil, cos, pi, sin, sqrt
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from steradian.errors import InvalidInput
from steradian.masks.mask import Mask
from steradian.validation import Value, quantity

SPREAD = 1.8
"""A slice's number of points doubles while its chord exceeds this times the distance to the slice before."""


class EquiSteradian(Value):
    """Parameters of an equi-steradian mask around a point of interest above the centre of the aperture."""

    arrangement: Literal["equi-steradian"] = "equi-steradian"
    aperture: float = quantity("m", "Side X of the square aperture", gt=0, le=1)
    depth: float = quantity("m", "Distance r0 of the point of interest from the sensor plane", gt=0, le=1)
    count: int = quantity(
        "points", "Wanted number of points; rounded up to the next that ends on the rim", ge=5, le=1_000_000
    )

    def build(self) -> Mask:
        """Place the points.

        Raises
        ------
        InvalidInput
            When no convenient count is near (never seen for counts of at least 5).
        """
        rings = _convenient_rings(self.aperture, self.depth, self.count)
        positions = rings.project(self.depth)
        distance = np.sqrt((positions**2).sum(axis=1) + self.depth**2)
        weights = distance**3  # paper, section 4.2: h ∝ r³
        return Mask.create(
            aperture=self.aperture,
            depth=self.depth,
            positions=positions,
            weights=weights * (self.aperture**2 / weights.sum()),
            arrangement=self.model_dump() | {"slices": list(rings.counts)},
        )


def equi_steradian_mask(aperture: float, depth: float, count: int) -> Mask:
    """Arrange points so that each covers the same solid angle seen from the point of interest.

    Parameters
    ----------
    aperture
        Side X of the square aperture in metres.
    depth
        Distance r0 of the point of interest from the sensor plane in metres; it lies above the aperture's centre.
    count
        Wanted number of points. Slices hold powers of two and the last one ends on the rim, so the count is
        rounded up to the next convenient value (1,600 becomes 1,605; see :func:`convenient_counts`).

    Returns
    -------
    Mask
        Points within the disc inscribed in the aperture, innermost first; weights h ∝ r³ that sum to X².

    Raises
    ------
    InvalidInput
        Naming the parameter and its allowed range.

    Notes
    -----
    Paper, appendix A and section 4.2.

    Examples
    --------
    >>> equi_steradian_mask(aperture=13.56e-3, depth=3.6e-3, count=1600).count
    1605
    """
    return EquiSteradian.create(aperture=aperture, depth=depth, count=count).build()


def convenient_counts(aperture: float, depth: float, count: int) -> tuple[int | None, int]:
    """Nearest convenient counts around ``count``: the largest below it (``None`` if there is none) and the next.

    The second is ``count`` itself where that is convenient.
    """
    upper = sum(_convenient_rings(aperture, depth, count).counts)
    cap = 2 * pi * (1 - cos(atan(aperture / 2 / depth)))
    for lower in range(count - 1, max(4, count // 2), -1):
        if sum(_rings(cap, lower).counts) == lower:
            return lower, upper
    return None, upper


@dataclass(frozen=True)
class _Rings:
    """Slices of a spherical cap: polar mid angle (rad) and number of points of each."""

    angles: tuple[float, ...]
    counts: tuple[int, ...]

    def project(self, depth: float) -> NDArray[np.float64]:
        """Positions (M, 2) in metres where the slices' points meet the sensor plane."""
        pieces, turn = [], 0.0
        for angle, count in zip(self.angles, self.counts, strict=True):
            azimuth = 2 * pi * np.arange(count) / count + pi / count + turn
            radius = depth * np.tan(angle)
            pieces.append(radius * np.column_stack([np.cos(azimuth), np.sin(azimuth)]))
            turn = float(azimuth[0])
        return np.concatenate(pieces)


def _rings(cap: float, count: int) -> _Rings:
    """Slice a cap of ``cap`` steradians into units of ``cap / count``, from the pole until ``count`` are used up.

    The outer polar angle of a slice follows from unit · j = 2π (cos θ_inner − cos θ_outer).
    """
    unit = cap / count / (2 * pi)  # in units of 2π, as 1 − cos θ
    angles, counts = [0.0], [1]
    total, number = 1, 2  # a slice of one has no neighbours to measure a chord between
    cosine = 1 - unit
    while total < count:
        while True:
            outer = max(cosine - unit * number, -1.0)
            angle = (acos(cosine) + acos(outer)) / 2
            if _chord(angle, number) <= SPREAD * _nearest(angle, angles[-1], number):
                break
            number *= 2
        angles.append(angle)
        counts.append(number)
        total += number
        cosine = outer
    return _Rings(tuple(angles), tuple(counts))


def _chord(angle: float, count: int) -> float:
    """Distance between neighbours of a slice on the unit sphere."""
    return 2 * sin(angle) * sin(pi / count)


def _nearest(angle: float, inner: float, count: int) -> float:
    """Distance on the unit sphere to the closest point of the slice before, which lies π/count off in azimuth."""
    along = cos(angle) * cos(inner) + sin(angle) * sin(inner) * cos(pi / count)
    return sqrt(max(0.0, 2 - 2 * along))


def _convenient_rings(aperture: float, depth: float, count: int) -> _Rings:
    """Slices for the smallest convenient count of at least ``count``: its last slice ends on the rim."""
    cap = 2 * pi * (1 - cos(atan(aperture / 2 / depth)))
    step_limit = count + 8 * ceil(sqrt(count)) * 4 + 64
    for candidate in range(count, step_limit):
        rings = _rings(cap, candidate)
        if sum(rings.counts) == candidate:
            return rings
    raise InvalidInput("count", count, f"a count with a convenient value up to {step_limit}")
