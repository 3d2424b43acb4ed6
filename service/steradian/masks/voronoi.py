"""Voronoi cells of points, clipped to the aperture: the usual compensation of an uneven density."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FAR = 8.0
"""Distance in apertures of the helper points that close every cell; their own cells stay outside the aperture."""


def voronoi_areas(positions: NDArray[np.float64], aperture: float) -> NDArray[np.float64]:
    """Areas of the Voronoi cells within the aperture.

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
    places, which, twins = np.unique(positions / aperture, axis=0, return_inverse=True, return_counts=True)
    which = which.reshape(-1)
    cells = _segments(places[:, 0]) if positions.shape[1] == 1 else _cells(places)
    found: NDArray[np.float64] = (cells / twins)[which] * aperture ** positions.shape[1]
    return found


def _segments(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths of the cells of ascending places within [−1/2, 1/2]."""
    return np.diff(np.concatenate([[-0.5], (places[:-1] + places[1:]) / 2, [0.5]]))


def _cells(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Areas (M,) of the cells of distinct places within the unit square.

    A cell's corners are the circumcentres of the Delaunay triangles around its point.
    """
    from scipy.spatial import Delaunay

    angle = np.arange(8) * (np.pi / 4)
    points = np.concatenate([places, FAR * np.column_stack([np.cos(angle), np.sin(angle)])])
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
    beyond = np.abs(centres).max(axis=1) > 0.5
    cut = np.unique(triangles[beyond])
    for point, corners in _corners_of(cut[cut < len(places)], triangles, centres):
        areas[point] = _clipped_area(corners)
    # points too close to another to be told apart got no triangles: they share its cell
    for lone, _, other in net.coplanar:
        areas[lone] = areas[other] = areas[other] / 2
    return areas[: len(places)]


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _circumcentres(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Centres (T, 2) of the circles through triangles (T, 3, 2), counted from their first corner for precision."""
    b, c = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    twice = 2 * _cross(b, c)
    twice = np.where(twice == 0, np.finfo(float).tiny, twice)
    bb, cc = (b**2).sum(axis=1), (c**2).sum(axis=1)
    offset = np.column_stack([c[:, 1] * bb - b[:, 1] * cc, b[:, 0] * cc - c[:, 0] * bb]) / twice[:, None]
    centres: NDArray[np.float64] = corners[:, 0] + offset
    return centres


def _corners_of(
    wanted: NDArray[np.int64], triangles: NDArray[np.int64], centres: NDArray[np.float64]
) -> list[tuple[int, NDArray[np.float64]]]:
    """Corners (V, 2) of some points' cells, in order around each."""
    flat = triangles.ravel()
    mine = np.flatnonzero(np.isin(flat, wanted))
    mine = mine[np.argsort(flat[mine], kind="stable")]
    starts = np.flatnonzero(np.diff(flat[mine], prepend=-1))
    found = []
    for group in np.split(mine, starts[1:]):
        if len(group):
            corners = centres[group // 3]
            around = corners - corners.mean(axis=0)
            found.append((int(flat[group[0]]), corners[np.argsort(np.arctan2(around[:, 1], around[:, 0]))]))
    return found


def _clipped_area(outline: NDArray[np.float64]) -> float:
    """Area of a convex polygon (V, 2) within the unit square, by clipping it to one side after another."""
    for axis in (0, 1):
        for sign in (1.0, -1.0):
            outline = _clip(outline, axis, sign)
            if len(outline) < 3:
                return 0.0
    x, y = outline.T
    return float(abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2)


def _clip(outline: NDArray[np.float64], axis: int, sign: float) -> NDArray[np.float64]:
    """Keep what of a polygon lies at sign · coordinate ≤ 1/2."""
    beyond = sign * outline[:, axis] - 0.5
    kept = []
    for here in range(len(outline)):
        before = here - 1
        if (beyond[here] > 0) != (beyond[before] > 0):
            share = beyond[before] / (beyond[before] - beyond[here])
            kept.append(outline[before] + share * (outline[here] - outline[before]))
        if beyond[here] <= 0:
            kept.append(outline[here])
    return np.array(kept).reshape(-1, 2)
