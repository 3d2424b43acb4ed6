"""Linear interpolation from scattered sensors to a grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput

Ints = NDArray[np.int64]


def linear_gridding_weights(
    places: NDArray[np.float64], grid: tuple[int, int], shift: tuple[float, float]
) -> tuple[Ints, Ints, Ints, NDArray[np.float64]]:
    """Return the weights of linear interpolation from scattered sensors to the grid's points.

    Parameters
    ----------
    places
        Shape (M, 2) in periods, in [0, 1); the first column is constant in 2-D, where grid[0] is 1.
    grid, shift
        Points a period and displacement in cells, an axis each.

    Returns
    -------
    tuple
        Line, cell, sensor and weight of each entry. Inside the sensors' hull linear (Delaunay triangles), outside the
        nearest sensor.

    Raises
    ------
    InvalidInput
        If the sensors span no triangle (3-D), or there are fewer than 2 (2-D).
    """
    points = [(np.arange(n) + s) / n for n, s in zip(grid, shift, strict=True)]
    if grid[0] == 1:
        return _line(places[:, 1], points[1])
    return _plane(places, points)


def _line(u: NDArray[np.float64], points: NDArray[np.float64]) -> tuple[Ints, Ints, Ints, NDArray[np.float64]]:
    if len(u) < 2:
        raise InvalidInput("sensors", f"{len(u)} sensors", "at least 2 to interpolate between")
    order = np.argsort(u, kind="stable")
    right = np.clip(np.searchsorted(u[order], points), 1, len(u) - 1)
    a, b = order[right - 1], order[right]
    gap = np.where(u[b] > u[a], u[b] - u[a], 1.0)
    share = np.clip((points - u[a]) / gap, 0.0, 1.0)
    cells = np.arange(len(points))
    return (
        np.zeros(2 * len(points), np.int64),
        np.concatenate([cells, cells]),
        np.concatenate([a, b]).astype(np.int64),
        np.concatenate([1 - share, share]),
    )


def _plane(
    places: NDArray[np.float64], points: list[NDArray[np.float64]]
) -> tuple[Ints, Ints, Ints, NDArray[np.float64]]:
    from scipy.spatial import Delaunay, QhullError, cKDTree

    try:
        triangles = Delaunay(places)
    except (QhullError, ValueError) as error:
        raise InvalidInput("sensors", f"{len(places)} sensors", "sensors that span a triangle") from error
    lines, cells = (v.ravel() for v in np.meshgrid(*(np.arange(len(p)) for p in points), indexing="ij"))
    where = np.stack([points[0][lines], points[1][cells]], axis=1)
    found = triangles.find_simplex(where)
    inside = found >= 0
    affine = triangles.transform[found[inside]]
    two = np.einsum("pab,pb->pa", affine[:, :2], where[inside] - affine[:, 2])
    shares = np.concatenate([two, 1 - two.sum(axis=1, keepdims=True)], axis=1)
    sensors = triangles.simplices[found[inside]]
    flat = np.isfinite(shares).all(axis=1)  # a degenerate triangle has no coordinates
    shares[~flat] = (1.0, 0.0, 0.0)
    _, nearest = cKDTree(places).query(where[~inside])
    inner, outer = np.flatnonzero(inside), np.flatnonzero(~inside)
    point = np.concatenate([np.repeat(inner, 3), outer])
    return (
        lines[point].astype(np.int64),
        cells[point].astype(np.int64),
        np.concatenate([sensors.ravel(), np.ravel(nearest)]).astype(np.int64),
        np.concatenate([shares.ravel(), np.ones(len(outer))]),
    )
