"""Weights: which share of the aperture each point stands for."""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from steradian.masks.mask import Mask
from steradian.masks.voronoi import voronoi_areas

Weighting: TypeAlias = Literal["analytic", "voronoi", "uniform"]
"""``analytic``: one over the density the arrangement was made with; ``voronoi``: each point's own cell, clipped to
the aperture; ``uniform``: equal shares."""


def normalised(relative: NDArray[np.float64], total: float) -> NDArray[np.float64]:
    """Scale ``relative`` (M,) to a sum of ``total``."""
    scaled: NDArray[np.float64] = relative * (total / relative.sum())
    return scaled


def weights_for(
    weighting: Weighting, positions: NDArray[np.float64], aperture: float, analytic: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Weights of points.

    Parameters
    ----------
    weighting
        Which rule to follow.
    positions
        (M, 2) metres, or (M, 1) for a line.
    aperture
        Side X in metres.
    analytic
        (M,) relative weights from the arrangement's own density.

    Returns
    -------
    ndarray
        (M,) areas in m² whose sum is X² (X for a line).
    """
    match weighting:
        case "analytic":
            relative = analytic
        case "voronoi":
            relative = voronoi_areas(positions, aperture)
        case "uniform":
            relative = np.ones(len(positions))
    return normalised(relative, aperture ** positions.shape[1])


def reweighted(mask: Mask, weighting: Literal["voronoi", "uniform"]) -> Mask:
    """Make the same points' mask with other weights.

    Examples
    --------
    >>> from steradian import equi_steradian_mask
    >>> round(reweighted(equi_steradian_mask(13.56e-3, 3.6e-3, 100), "uniform").weight_ratio, 9)
    1.0
    """
    weights = weights_for(weighting, mask.positions, mask.aperture, mask.weights)
    return mask.replace(weights=weights, arrangement=mask.arrangement | {"weighting": weighting})
