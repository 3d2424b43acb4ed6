"""Weights of a mask: the area of the plane that each point represents."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from steradian.core.choices import Weighting
from steradian.imaging.geometry import polygons as outlines
from steradian.imaging.geometry.polygons import Outline
from steradian.imaging.geometry.sensor_areas import sensed_region
from steradian.imaging.geometry.voronoi import voronoi_cell_areas

if TYPE_CHECKING:
    from steradian.masks.mask import Mask


def voronoi_areas(positions: NDArray[np.float64], aperture: float) -> NDArray[np.float64]:
    """Return the areas of the points' Voronoi cells within the whole aperture.

    Parameters
    ----------
    positions
        (M, 2) metres within [−X/2, X/2]², or (M, 1) within [−X/2, X/2].
    aperture
        Side X in metres.

    Returns
    -------
    ndarray
        (M,) areas in m² (lengths in m); their sum is X² (X). Points at the same place share a cell equally.
    """
    half = np.full(positions.shape[1], aperture / 2)
    return voronoi_cell_areas(positions, outlines.rectangle(-half, half))


def expand_outline(outline: Outline, positions: NDArray[np.float64]) -> Outline:
    """Extend an outline to nearby points, for example those moved onto a scanner's grid."""
    if outline.shape[1] == 2 and outlines.contains(outline, positions).all():
        return outline
    return outlines.convex_hull(np.concatenate([outline, positions]))


def weights_for(
    weighting: Weighting, positions: NDArray[np.float64], outline: Outline, analytic: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the weights of points by a given method.

    Parameters
    ----------
    weighting
        Which rule to follow.
    positions
        (M, 2) metres, or (M, 1) for a line.
    outline
        Of what the points sense.
    analytic
        (M,) relative weights from the arrangement's own density.

    Returns
    -------
    ndarray
        (M,) areas in m² (lengths in m) whose sum is the outline's area.
    """
    match weighting:
        case "analytic":
            relative = analytic
        case "voronoi":
            relative = voronoi_cell_areas(positions, outline)
        case "uniform":
            relative = np.ones(len(positions))
    scaled: NDArray[np.float64] = relative * (outlines.area(outline) / relative.sum())
    return scaled


def resolve_outline(mask: Mask) -> Outline:
    """Return the outline of the sensed area of a mask, computed from its points if not given."""
    return sensed_region(mask.positions, mask.aperture) if mask.outline is None else mask.outline


def with_weights(mask: Mask, weighting: Literal["voronoi", "uniform"]) -> Mask:
    """Return a mask of the same points with other weights.

    Examples
    --------
    >>> from steradian import equi_steradian_mask
    >>> round(with_weights(equi_steradian_mask(13.56e-3, 3.6e-3, 100), "uniform").weight_ratio, 9)
    1.0
    """
    outline = resolve_outline(mask)
    weights = weights_for(weighting, mask.positions, outline, mask.weights)
    arrangement = mask.arrangement | {"weighting": weighting}
    return mask.replace(weights=weights, outline=outline, arrangement=arrangement)
