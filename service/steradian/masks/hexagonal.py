"""Hexagonal lattices: the fewest points for a given lateral bandwidth (paper, section 4)."""

from __future__ import annotations

from math import floor, sqrt
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from steradian.imaging import outlines
from steradian.imaging.outlines import Outline
from steradian.masks.mask import Mask
from steradian.masks.weights import Weighting, weights_for
from steradian.ranges import LENGTH
from steradian.validation import Value, quantity


class Hexagonal(Value):
    """Parameters of a lattice of equilateral triangles that fills the aperture, with a point at the centre."""

    arrangement: Literal["hexagonal"] = "hexagonal"
    aperture: float = quantity("m", "Side X of the square aperture", **LENGTH.limits)
    interval: float = quantity("m", "Distance between neighbours", **LENGTH.limits)
    weighting: Weighting = "analytic"

    @property
    def expected_count(self) -> int:
        """About how many points the mask will have."""
        return round((self.aperture / self.interval) ** 2 * 2 / sqrt(3)) + 1

    def build(self) -> Mask:
        """Place the points."""
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
            arrangement=self.model_dump(mode="json"),
        )

    def _outline(self, positions: NDArray[np.float64], rise: float) -> Outline:
        """Rectangle of all cells: rows half a rise beyond the outermost, as wide as they are on average."""
        half = np.full(2, self.aperture / 2)
        if len(positions) == 1:
            return outlines.rectangle(-half, half)
        low, high = positions[:, 1].min() - rise / 2, positions[:, 1].max() + rise / 2
        width, middle = len(positions) * self.interval * rise / (high - low), float(positions[:, 0].mean())
        return outlines.rectangle((middle - width / 2, low), (middle + width / 2, high))


def hexagonal_mask(aperture: float, interval: float, *, weighting: Weighting = "analytic") -> Mask:
    """Fill the aperture with a hexagonal lattice.

    Parameters
    ----------
    aperture
        Side X of the square aperture in metres.
    interval
        Distance between neighbours in metres.
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
    return Hexagonal.create(aperture=aperture, interval=interval, weighting=weighting).build()
