"""Convex polygons in the sensor plane."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Outline = NDArray[np.float64]
CORNERS = 180
"""Corners of a disc's outline; its area is exact, its radius within 5e-5."""
ROUND = 32
"""Corners of the discs that widen a hull."""
_FLAT, _SHORT = 1e-9, 1e-9
"""A corner that turns the wrong way by so little, as a share of the area, and a side so short, of the longest, are
rounding."""


def rectangle(low: ArrayLike, high: ArrayLike) -> Outline:
    """Return the rectangle between two corners, on a line an interval; corners have one coordinate an axis."""
    a, b = np.asarray(low, np.float64), np.asarray(high, np.float64)
    if len(a) == 1:
        return np.array([a, b])
    return np.array([[a[0], a[1]], [b[0], a[1]], [b[0], b[1]], [a[0], b[1]]])


def disc(centre: ArrayLike, radius: float, corners: int = CORNERS) -> Outline:
    """Return a polygon with a disc's area, symmetric to the axes, as its approximation."""
    angle = (np.arange(corners) + 0.5) * (2 * np.pi / corners)
    reach = radius * np.sqrt(2 * np.pi / corners / np.sin(2 * np.pi / corners))
    found: Outline = np.asarray(centre, np.float64) + reach * np.column_stack([np.cos(angle), np.sin(angle)])
    return found


def area(outline: Outline) -> float:
    """Return a polygon's area in m², on a line its length in m."""
    if outline.shape[1] == 1:
        return float(outline[1, 0] - outline[0, 0])
    x, y = (outline - outline.mean(axis=0)).T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def convex_hull(points: NDArray[np.float64]) -> Outline:
    """Return the convex hull of points (N, d): both ends for collinear points, one for coincident points."""
    from scipy.spatial import ConvexHull, QhullError

    if points.shape[1] == 1:
        return np.array([points.min(axis=0), points.max(axis=0)])
    if len(points) > 2:
        try:
            found: Outline = points[ConvexHull(points).vertices]
            return found
        except QhullError:  # no area
            pass
    from_middle = points - points.mean(axis=0)
    along = from_middle @ from_middle[np.square(from_middle).sum(axis=1).argmax()]
    ends: Outline = points[np.unique([along.argmin(), along.argmax()])]
    return ends


def buffered_hull(outline: Outline, by: float) -> Outline:
    """Return the convex hull dilated by ``by`` metres."""
    if outline.shape[1] == 1:
        longer: Outline = outline + np.array([[-by], [by]])
        return longer
    around = disc((0.0, 0.0), by, ROUND)
    return convex_hull((outline[:, None] + around).reshape(-1, 2))


def clip_half_plane(outline: Outline, normal: NDArray[np.float64], limit: float) -> Outline:
    """Return the part of a polygon with normal · r ≤ limit; (0, 2) if it is empty."""
    beyond = outline @ normal - limit
    inside = beyond <= 0
    if inside.all():
        return outline
    following = np.concatenate([np.arange(1, len(outline)), [0]])  # cutting is done by the thousand: no np.roll
    after, next_inside = beyond[following], inside[following]
    crosses = inside != next_inside
    share = np.divide(beyond, beyond - after, out=np.zeros_like(beyond), where=crosses)
    met = outline + share[:, None] * (outline[following] - outline)
    both = np.stack([outline, met], axis=1)
    kept: Outline = both[np.stack([inside, crosses], axis=1)]
    return kept


def intersection(outline: Outline, other: Outline) -> Outline:
    """Return the intersection of two convex polygons."""
    if outline.shape[1] == 1:
        low, high = max(outline[0, 0], other[0, 0]), min(outline[1, 0], other[1, 0])
        return np.array([[low], [max(low, high)]])
    for corner, following in zip(other, np.roll(other, -1, axis=0), strict=True):
        outward = np.array([following[1] - corner[1], corner[0] - following[0]])
        outline = clip_half_plane(outline, outward, float(outward @ corner))
    return outline


def is_convex(outline: Outline) -> bool:
    """Return whether corners form a simple convex polygon in anticlockwise order."""
    if outline.shape[1] == 1:
        return len(outline) == 2 and bool(outline[0, 0] < outline[1, 0])
    if len(outline) < 3 or not area(outline) > 0:
        return False
    side = np.roll(outline, -1, axis=0) - outline
    length = np.linalg.norm(side, axis=1)
    side = side[length > _SHORT * length.max()]
    along = np.roll(side, -1, axis=0)
    turn = side[:, 0] * along[:, 1] - side[:, 1] * along[:, 0]
    bend = np.arctan2(turn, (side * along).sum(axis=1))
    return bool((turn >= -_FLAT * area(outline)).all() and abs(bend.sum() - 2 * np.pi) < 1e-6)


def contains(outline: Outline, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return whether each of points (N, 2) lies within a polygon or on its sides."""
    middle = outline.mean(axis=0)
    corners, wanted = outline - middle, points - middle
    angle = np.arctan2(corners[:, 1], corners[:, 0])
    corners = np.roll(corners, -int(angle.argmin()), axis=0)
    angle = np.roll(angle, -int(angle.argmin()))
    side = np.searchsorted(angle, np.arctan2(wanted[:, 1], wanted[:, 0]), side="right") - 1
    a = corners[side]
    b = corners[(side + 1) % len(corners)]
    found: NDArray[np.bool_] = (b[:, 0] - a[:, 0]) * (wanted[:, 1] - a[:, 1]) >= (b[:, 1] - a[:, 1]) * (
        wanted[:, 0] - a[:, 0]
    )
    return found
