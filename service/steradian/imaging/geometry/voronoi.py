"""Areas of Voronoi cells clipped to an outline."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from steradian.imaging.geometry import polygons as outlines
from steradian.imaging.geometry.polygons import Outline

FAR_RADIUS = 8.0
"""Distance in extents of the helper points that close every cell; their own cells stay outside the outline."""


def voronoi_cell_areas(positions: NDArray[np.float64], outline: Outline) -> NDArray[np.float64]:
    """Return the areas of the points' Voronoi cells, clipped to an outline.

    Parameters
    ----------
    positions
        (M, 2) metres, or (M, 1) on a line.
    outline
        Of what the points cover (:mod:`steradian.imaging.geometry.polygons`).

    Returns
    -------
    ndarray
        (M,) areas in m² (lengths in m); their sum is the outline's area. Points at the same place share a cell.
    """
    both = np.concatenate([positions, outline])
    low, high = both.min(axis=0), both.max(axis=0)
    middle, size = (low + high) / 2, float((high - low).max())
    if size == 0:
        return np.zeros(len(positions))
    scaled = np.round((positions - middle) / size, 12)
    places, which, twins = np.unique(scaled, axis=0, return_inverse=True, return_counts=True)
    which = which.reshape(-1)
    edge = (outline - middle) / size
    areas = _segments(places[:, 0], edge) if positions.shape[1] == 1 else _polygons(places, edge)
    areas *= outlines.area(edge) / areas.sum()
    found: NDArray[np.float64] = (areas / twins)[which] * size ** positions.shape[1]
    return found


def _segments(places: NDArray[np.float64], edge: Outline) -> NDArray[np.float64]:
    """Return the lengths of the 1-D Voronoi cells of ascending positions."""
    bounds = np.concatenate([edge[0], (places[:-1] + places[1:]) / 2, edge[1]])
    return np.diff(np.clip(bounds, edge[0, 0], edge[1, 0]))


def _polygons(places: NDArray[np.float64], edge: Outline) -> NDArray[np.float64]:
    """Return the areas (K,) of the 2-D Voronoi cells of distinct points.

    A cell's corners are the circumcentres of the Delaunay triangles around its point; what a cell that reaches beyond
    the edge has within is the edge's polygon, cut by the perpendicular bisectors to the point's neighbours.
    """
    from scipy.spatial import Delaunay

    angle = np.arange(8) * (np.pi / 4)
    points = np.concatenate([places, FAR_RADIUS * np.column_stack([np.cos(angle), np.sin(angle)])])
    net = Delaunay(points)
    triangles = net.simplices.astype(np.int64)
    centres = _circumcentres(points[triangles])
    areas = np.zeros(len(points))
    for corner in range(3):
        own, left, right = (points[triangles[:, (corner + step) % 3]] for step in range(3))
        reach = centres - own
        share = (_cross(left - own, reach) + _cross(reach, right - own)) / 4
        areas += np.bincount(triangles[:, corner], share, minlength=len(points))
    areas = np.abs(areas)
    cut = np.unique(triangles[~outlines.contains(edge, centres)])
    starts, neighbours = net.vertex_neighbor_vertices
    for point in cut[cut < len(places)]:
        areas[point] = _clip_to_outline(edge, points[point], points[neighbours[starts[point] : starts[point + 1]]])
    # points too close to another to be told apart got no triangles: they share its cell
    for lone, _, other in net.coplanar:
        areas[lone] = areas[other] = areas[other] / 2
    return areas[: len(places)]


def _clip_to_outline(edge: Outline, point: NDArray[np.float64], neighbours: NDArray[np.float64]) -> float:
    """Return the area of a point's Voronoi cell, clipped to the outline."""
    cell = edge
    away = neighbours - point
    limits = (away * (neighbours + point)).sum(axis=1) / 2
    for one in np.argsort((away**2).sum(axis=1)):  # the nearest cut most away
        cell = outlines.clip_half_plane(cell, away[one], limits[one])
        if len(cell) < 3:
            return 0.0
    return outlines.area(cell)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _circumcentres(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the circumcentres (T, 2) of triangles (T, 3, 2), relative to the first corner for precision."""
    b, c = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    twice = 2 * _cross(b, c)
    twice = np.where(twice == 0, np.finfo(float).tiny, twice)
    bb, cc = (b**2).sum(axis=1), (c**2).sum(axis=1)
    offset = np.column_stack([c[:, 1] * bb - b[:, 1] * cc, b[:, 0] * cc - c[:, 0] * bb]) / twice[:, None]
    centres: NDArray[np.float64] = corners[:, 0] + offset
    return centres
