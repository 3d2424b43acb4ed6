"""The limited view: which edges a plane of sensors can see (paper, section 4, after Xu et al. 2004).

Waves leave an edge along its normal. An edge is visible where the normal line through it meets the sensors, and no
plane sees edges perpendicular to itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from steradian.errors import InvalidInput

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
    steepest_left: NDArray[np.float64]
    steepest_right: NDArray[np.float64]
    share: NDArray[np.float64]
    detection_region: NDArray[np.bool_]


def limited_view(mask: Mask, deepest: float, *, y: float | None = None, pixels: int = 96) -> LimitedView:
    """Map the visible edges over depth, for the rectangle that the sensors span.

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
    low, high = mask.film_positions.min(axis=0), mask.film_positions.max(axis=0)
    left = np.arctan((x[:, None] - low[0]) / z)
    right = np.arctan((high[0] - x[:, None]) / z)
    if mask.is_line:
        share = np.maximum(left + right, 0) / np.pi
    else:
        share = _solid_angle(x[:, None] + 0 * z, cut, z + 0 * x[:, None], low, high) / (2 * np.pi)
    within = (x >= low[0]) & (x <= high[0]) & (mask.is_line or low[1] <= cut <= high[1])
    return LimitedView(x, z, cut, left, right, share, np.repeat(within[:, None], pixels, axis=1))


def visible_share(mask: Mask, point: tuple[float, float, float]) -> float:
    """Tell which share of all orientations of an edge at ``point`` (x, y, z in metres) is visible, 0 to 1."""
    low, high = mask.film_positions.min(axis=0), mask.film_positions.max(axis=0)
    x, y, z = np.asarray(point, np.float64)
    if mask.is_line:
        return float(max(np.arctan((x - low[0]) / z) + np.arctan((high[0] - x) / z), 0) / np.pi)
    return float(_solid_angle(x, y, z, low, high) / (2 * np.pi))


def _solid_angle(
    x: NDArray[np.float64], y: float, z: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Solid angle of the rectangle from ``low`` to ``high`` in the plane z = 0, seen from (x, y, z)."""
    total = np.zeros_like(x)
    for (x_end, x_sign), (y_end, y_sign) in product(((high[0], 1), (low[0], -1)), ((high[1], 1), (low[1], -1))):
        a, b = x_end - x, y_end - y
        total += x_sign * y_sign * np.arctan(a * b / (z * np.sqrt(a**2 + b**2 + z**2)))
    return total
