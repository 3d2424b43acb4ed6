"""Rectangular grids, the arrangement that scanners use today."""

from __future__ import annotations

from typing import Literal

import numpy as np

from steradian.errors import InvalidInput
from steradian.masks.mask import Mask
from steradian.validation import Value, quantity


class Grid(Value):
    """Parameters of a square grid of points."""

    arrangement: Literal["grid"] = "grid"
    aperture: float = quantity("m", "Side X of the square aperture", gt=0, le=1)
    count: int = quantity("points", "Points on each axis", ge=1, le=4096)
    interval: float = quantity("m", "Distance between neighbours", gt=0, le=1)

    def build(self) -> Mask:
        """Place the points.

        Raises
        ------
        InvalidInput
            When the grid is wider than the aperture.
        """
        # An even grid sits on multiples of the interval from -n/2 to n/2-1, like FFT modes; an odd one is symmetric.
        steps = np.arange(self.count) - self.count // 2
        if self.count * self.interval > self.aperture * (1 + 1e-9):
            raise InvalidInput(
                "interval", f"{self.interval:g}", f"at most aperture / count = {self.aperture / self.count:g} (m)"
            )
        x, y = np.meshgrid(steps * self.interval, steps * self.interval, indexing="ij")
        total = self.count**2
        return Mask.create(
            aperture=self.aperture,
            positions=np.column_stack([x.ravel(), y.ravel()]),
            weights=np.full(total, self.aperture**2 / total),
            arrangement=self.model_dump(),
        )


def grid_mask(aperture: float, count: int, interval: float) -> Mask:
    """Arrange ``count`` × ``count`` points at equal distance, equally weighted.

    Parameters
    ----------
    aperture
        Side X of the square aperture in metres.
    count
        Points on each axis. An even count lies on −n/2 … n/2−1 intervals, an odd one symmetric to the centre.
    interval
        Distance between neighbours in metres.

    Returns
    -------
    Mask
        Points with x slowest; weights X²/M.

    Raises
    ------
    InvalidInput
        Naming the parameter and its allowed range.

    Examples
    --------
    >>> grid_mask(aperture=13.56e-3, count=41, interval=300e-6).count
    1681
    """
    return Grid.create(aperture=aperture, count=count, interval=interval).build()
