"""Areas that sensors stand for: the h_m of the paper's sum over non-equispaced sensors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.errors import InvalidInput


def voronoi_weights(positions: ArrayLike, aperture: float | tuple[float, ...]) -> NDArray[np.float64]:
    """Areas of the Voronoi cells, clipped to the aperture.

    Parameters
    ----------
    positions
        Shape (M, 2), or (M,) on a line, in metres, within the aperture centred on 0. Sensors at the same place share
        their cell.
    aperture
        Side lengths in metres, one number or one an axis.

    Returns
    -------
    ndarray
        h, shape (M,), in m² (m on a line); Σ h is the aperture's area.

    Raises
    ------
    InvalidInput
        With fewer than 3 different places, or sensors outside the aperture.
    """
    x = np.array(positions, np.float64)
    x = x[:, None] if x.ndim == 1 else x
    sides = np.broadcast_to(np.asarray(aperture, np.float64), (x.shape[1],))
    if (np.abs(x) > sides / 2 * (1 + 1e-9)).any():
        raise InvalidInput(
            "positions", "a sensor outside the aperture", "positions within the aperture for Voronoi areas"
        )
    places, which, number = np.unique(np.round(x / sides, 12), axis=0, return_inverse=True, return_counts=True)
    if len(places) < 3:
        raise InvalidInput("positions", f"{len(places)} different places", "at least 3 for Voronoi areas")
    # a hair inside, so that no sensor on the rim meets its own mirror image
    inside = np.clip(places, -0.5 * (1 - 1e-9), 0.5 * (1 - 1e-9)) * sides
    area = _lengths(inside[:, 0], float(sides[0])) if x.shape[1] == 1 else _areas(inside, sides)
    area *= float(np.prod(sides)) / area.sum()
    which = np.ravel(which)
    shared: NDArray[np.float64] = area[which] / number[which]
    return shared


def _lengths(x: NDArray[np.float64], side: float) -> NDArray[np.float64]:
    """Cells of rising positions on a line."""
    bounds = np.concatenate([[-side / 2], (x[1:] + x[:-1]) / 2, [side / 2]])
    return np.diff(bounds)


def _areas(points: NDArray[np.float64], sides: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mirror the points in the four sides, then every cell of the originals is bounded by the aperture."""
    from scipy.spatial import Voronoi

    mirrored = [points]
    for axis in (0, 1):
        for side in (-1.0, 1.0):
            image = points.copy()
            image[:, axis] = side * sides[axis] - image[:, axis]
            mirrored.append(image)
    diagram = Voronoi(np.concatenate(mirrored))
    pairs = np.asarray(diagram.ridge_points)
    ends = np.asarray(diagram.ridge_vertices)
    bounded = (ends >= 0).all(axis=1)
    pairs, ends = pairs[bounded], ends[bounded]
    length = np.linalg.norm(diagram.vertices[ends[:, 0]] - diagram.vertices[ends[:, 1]], axis=1)
    # a cell is made of triangles from its point to each ridge, half the pair's distance high
    triangle = 0.25 * length * np.linalg.norm(diagram.points[pairs[:, 0]] - diagram.points[pairs[:, 1]], axis=1)
    area = np.zeros(len(diagram.points))
    np.add.at(area, pairs[:, 0], triangle)
    np.add.at(area, pairs[:, 1], triangle)
    return area[: len(points)]
