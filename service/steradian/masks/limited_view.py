"""Limited-view analysis: visible edge orientations per position.

Waves leave an edge along its normal. An edge is visible where the normal line through it meets the sensors, and no
plane sees edges perpendicular to itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging.geometry.polygons import Outline
from steradian.masks.weights import resolve_outline

if TYPE_CHECKING:
    from steradian.masks.mask import Mask


@dataclass(frozen=True)
class LimitedView:
    """Visible edges over a section perpendicular to the film.

    Attributes
    ----------
    x, z
        (Nx,), (Nz,) coordinates in metres.
    y
        Where the section lies, in metres.
    ends
        Where the sensors begin and end in it, x in metres; (∞, −∞) where it passes them by.
    steepest_left, steepest_right
        (Nx, Nz) tilt in radians of the steepest visible edges whose normal leans towards −x and +x; 0 is an edge
        parallel to the film. Edges between −steepest_left and +steepest_right are visible; where one is negative,
        not even parallel edges are.
    share
        (Nx, Nz) share of all orientations that are visible, 0 to 1: of directions in space, for a line in the plane.
    detection_region
        (Nx, Nz) whether the place lies between the normals on the film at the outermost sensors.
    """

    x: NDArray[np.float64]
    z: NDArray[np.float64]
    y: float
    ends: tuple[float, float]
    steepest_left: NDArray[np.float64]
    steepest_right: NDArray[np.float64]
    share: NDArray[np.float64]
    detection_region: NDArray[np.bool_]


def limited_view(mask: Mask, deepest: float, *, y: float | None = None, pixels: int = 96) -> LimitedView:
    """Compute the map of visible edges over depth, for the area covered by the sensors.

    Parameters
    ----------
    mask
        The mask.
    deepest
        Depth to go to in metres.
    y
        Where to cut, in metres; ``None`` at the point of interest.
    pixels
        Places on each axis of the map.

    Raises
    ------
    InvalidInput
        When ``deepest`` is not positive.
    """
    if not deepest > 0:
        raise InvalidInput("deepest", deepest, "> 0 (m)")
    cut = float(mask.offset[1]) if y is None else y
    x = (np.arange(pixels) + 0.5) / pixels * mask.aperture - mask.aperture / 2
    z = (np.arange(pixels) + 0.5) / pixels * deepest
    outline = resolve_outline(mask)
    low, high = (float(outline[0, 0]), float(outline[1, 0])) if mask.is_line else _chord(outline, cut)
    left = np.arctan((x[:, None] - low) / z)
    right = np.arctan((high - x[:, None]) / z)
    if mask.is_line:
        share = np.maximum(left + right, 0) / np.pi
    else:
        share = _solid_angle(outline, x[:, None] + 0 * z, cut, z + 0 * x[:, None]) / (2 * np.pi)
    within = (x >= low) & (x <= high)
    return LimitedView(x, z, cut, (low, high), left, right, share, np.repeat(within[:, None], pixels, axis=1))


def visible_fraction(mask: Mask, point: tuple[float, float, float]) -> float:
    """Return the visible fraction of all orientations of an edge at ``point`` (x, y, z in metres), 0 to 1."""
    outline = resolve_outline(mask)
    x, y, z = np.asarray(point, np.float64)
    if mask.is_line:
        low, high = outline[:, 0]
        return float(max(np.arctan((x - low) / z) + np.arctan((high - x) / z), 0) / np.pi)
    return float(_solid_angle(outline, x, y, z) / (2 * np.pi))


def _chord(outline: Outline, y: float) -> tuple[float, float]:
    """Return the interval in which a line at ``y`` crosses a convex polygon; (∞, −∞) if there is none."""
    if (upper := outline[outline[:, 1] == y, 0]).size > 1:  # along an edge
        return float(upper.min()), float(upper.max())
    after = np.roll(outline, -1, axis=0)
    met = (outline[:, 1] <= y) != (after[:, 1] <= y)
    if not met.any():
        return np.inf, -np.inf
    (x, begin), (x_after, end) = outline[met].T, after[met].T
    places = x + (y - begin) / (end - begin) * (x_after - x)
    return float(places.min()), float(places.max())


def _solid_angle(outline: Outline, x: NDArray[np.float64], y: float, z: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the solid angle of a polygon in the plane z = 0 seen from (x, y, z).

    The sum over its triangles (A. van Oosterom and J. Strackee, IEEE Trans. Biomed. Eng. 30, 1983).
    """
    corners = [(a - x, b - y) for a, b in outline]
    far = [np.sqrt(a**2 + b**2 + z**2) for a, b in corners]
    first, first_far = corners[0], far[0]
    total = np.zeros_like(x)
    for number in range(1, len(outline) - 1):
        (a, b), (c, d) = corners[number : number + 2]
        near, next_far = far[number : number + 2]
        side, other = outline[number] - outline[0], outline[number + 1] - outline[0]
        volume = z * (side[0] * other[1] - side[1] * other[0])
        along = first_far * near * next_far
        along = along + (first[0] * a + first[1] * b + z**2) * next_far
        along = along + (first[0] * c + first[1] * d + z**2) * near
        along = along + (a * c + b * d + z**2) * first_far
        total += 2 * np.arctan2(volume, along)
    return total
