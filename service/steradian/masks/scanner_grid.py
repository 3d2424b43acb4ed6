"""Grid of the positions that a scanner can reach, to which masks are snapped."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from steradian.core.quantity_ranges import LENGTH
from steradian.core.validation import Value, quantity_field


class ScannerGrid(Value):
    """Square grid of reachable scanner positions on −n/2 … n/2−1 intervals (symmetric for odd n)."""

    count: int = quantity_field("points", "Places on each axis", ge=1, le=65_536)
    interval: float = quantity_field("m", "Distance between neighbours", **LENGTH.limits)

    def snap(
        self, positions: NDArray[np.float64], weights: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Move each point to the nearest grid position; coinciding points merge and their weights are added.

        Parameters
        ----------
        positions
            (M, 1) or (M, 2) metres.
        weights
            (M,) of any scale.

        Returns
        -------
        positions, weights
            In the order in which the places were first met.
        """
        steps = np.rint(positions / self.interval).astype(np.int64)
        low = -(self.count // 2)
        steps = np.clip(steps, low, low + self.count - 1)
        _, first, which = np.unique(steps, axis=0, return_index=True, return_inverse=True)
        merged = np.bincount(which.reshape(-1), weights).astype(np.float64)
        order = np.argsort(first)
        places: NDArray[np.float64] = steps[first[order]].astype(np.float64) * self.interval
        return places, merged[order]
