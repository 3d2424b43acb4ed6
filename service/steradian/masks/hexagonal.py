"""Hexagonal lattices: the fewest points for a given lateral bandwidth (paper, section 4)."""

from __future__ import annotations

from itertools import pairwise
from math import floor, sqrt
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from steradian.core.choices import Weighting
from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import LENGTH
from steradian.core.validation import quantity_field
from steradian.imaging.geometry import polygons as outlines
from steradian.imaging.geometry.polygons import Outline
from steradian.masks.arrangement_base import (
    COUNT_FIELD,
    ArrangementBase,
    closeness_key,
    count_along_side,
    require_exactly_one,
)
from steradian.masks.mask import Mask
from steradian.masks.weights import weights_for

MOST_BUILT = 4096**2
"""Points, as many as the largest grid has."""


class Hexagonal(ArrangementBase):
    """Parameters of a hexagonal lattice that fills the aperture, with a point at the centre."""

    arrangement: Literal["hexagonal"] = "hexagonal"
    interval: float | None = quantity_field("m", "Distance between neighbours", default=None, **LENGTH.limits)
    count: int | None = quantity_field(
        "points",
        "Number of points instead of the interval; the nearest possible number is used",
        default=None,
        **COUNT_FIELD,
    )
    weighting: Weighting = "analytic"

    @model_validator(mode="after")
    def _check(self) -> Self:
        require_exactly_one(count=self.count, interval=self.interval)
        return self

    @property
    def expected_count(self) -> int:
        """Approximate number of points of the mask."""
        return self.count or round(count_along_side(self.aperture, self.lattice) ** 2 * 2 / sqrt(3)) + 1

    @property
    def lattice(self) -> float:
        """Distance between neighbours in metres, derived from the number of points if not given."""
        return self.interval or hexagonal_interval(self.aperture, self.count or 1)

    def build(self) -> Mask:
        """Build the hexagonal mask."""
        if self.interval is None:
            return self.replace(interval=self.lattice, count=None).build()
        least = self.aperture * sqrt(2 / sqrt(3) / MOST_BUILT)
        if self.interval < least:
            raise InvalidInput("interval", self.interval, f"at least {least:.3g} (m), {MOST_BUILT:,} points")
        half = self.aperture / 2
        rise = self.interval * sqrt(3) / 2
        rows = np.arange(-floor(half / rise), floor(half / rise) + 1)
        columns = np.arange(-floor(half / self.interval) - 1, floor(half / self.interval) + 2)
        row, column = np.meshgrid(rows, columns, indexing="ij")
        x = (column + (row % 2) / 2) * self.interval
        positions = np.column_stack([x.ravel(), (row * rise).ravel()])
        positions = positions[np.abs(positions).max(axis=1) <= half]
        outline = self._outline(positions, rise)
        return Mask.create(
            aperture=self.aperture,
            positions=positions,
            weights=weights_for(self.weighting, positions, outline, np.ones(len(positions))),
            outline=outline,
            **self._fields_of_mask(),
        )

    def _outline(self, positions: NDArray[np.float64], rise: float) -> Outline:
        """Return the rectangle of all lattice cells, as wide as the rows on average."""
        half = np.full(2, self.aperture / 2)
        if len(positions) == 1:
            return outlines.rectangle(-half, half)
        low, high = positions[:, 1].min() - rise / 2, positions[:, 1].max() + rise / 2
        width, middle = len(positions) * self.lattice * rise / (high - low), float(positions[:, 0].mean())
        return outlines.rectangle((middle - width / 2, low), (middle + width / 2, high))


def hexagonal_mask(
    aperture: float,
    interval: float | None = None,
    *,
    count: int | None = None,
    depth: float | None = None,
    offset: tuple[float, float] = (0.0, 0.0),
    weighting: Weighting = "analytic",
) -> Mask:
    """Return a mask of a hexagonal lattice that fills the aperture.

    Parameters
    ----------
    aperture
        Side X of the square aperture in metres.
    interval
        Distance between neighbours in metres.
    count
        Wanted number of points instead; the nearest that a lattice has is taken.
    depth, offset
        Of the point of interest in metres that the mask is judged for; the points do not depend on it.
    weighting
        ``analytic`` and ``uniform``: each point stands for a cell of the lattice, √3/2·interval², and the mask senses
        the rectangle of rows that they fill; ``voronoi``: cells within it, uneven at the ends of rows.

    Returns
    -------
    Mask
        Rows along x, bottom to top.

    Raises
    ------
    InvalidInput
        Naming the parameter and its allowed range.
    """
    return Hexagonal.create(
        aperture=aperture, interval=interval, count=count, depth=depth, offset=offset, weighting=weighting
    ).build()


def hexagonal_interval(aperture: float, count: int) -> float:
    """Return the interval in metres of the hexagonal lattice with the number of points nearest to ``count``.

    The number changes only where a row or a column more fits, so one interval between any two such places is tried;
    of two equally near numbers the larger is taken, and of the intervals that give it the widest.
    """
    guess = aperture * sqrt(2 / sqrt(3) / count)
    columns = range(1, 2 + floor(aperture / (0.4 * guess)))
    changes = {aperture / n for n in columns} | {aperture / (n * sqrt(3)) for n in columns}
    places = sorted({value for value in changes if 0.5 * guess <= value} | {0.5 * guess, 3 * max(guess, aperture)})
    middles = [(low + high) / 2 for low, high in pairwise(places) if high > low * (1 + 1e-9)]
    return min(middles, key=lambda interval: (*closeness_key(_lattice_count(aperture, interval), count), -interval))


def _lattice_count(aperture: float, interval: float) -> int:
    """Return the number of points of :func:`steradian.masks.hexagonal_mask`, without building the mask."""
    rows, half = floor(aperture / (interval * sqrt(3))), aperture / (2 * interval)
    even = 1 + 2 * (rows // 2)
    return even * (1 + 2 * floor(half)) + (2 * rows + 1 - even) * 2 * floor(half + 0.5)
