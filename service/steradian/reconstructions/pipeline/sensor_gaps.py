"""Fill distance (largest gap) of sensor positions within the aperture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

RASTER = 64
"""Places looked at along each side of the aperture."""


def largest_gap(positions: NDArray[np.float64], aperture: float) -> float:
    """Return the fill distance: the largest distance in metres from a place of the aperture to its nearest point.

    Parameters
    ----------
    positions
        (M, 2) metres, centred on the aperture, or (M, 1) on a line.
    aperture
        Its side in metres. 64 places along each side are looked at, so the result is too low by at most 1 % of it.
    """
    from scipy.spatial import KDTree

    axes = positions.shape[1]
    line = (np.arange(RASTER) + 0.5) / RASTER * aperture - aperture / 2
    places = np.stack(np.meshgrid(*[line] * axes, indexing="ij"), axis=-1).reshape(-1, axes)
    distances, _ = KDTree(positions).query(places)
    return float(np.max(distances))
