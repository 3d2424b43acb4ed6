"""Figures of merit of a mask: spacing, evenness, opening angle, sensed area."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging.geometry.voronoi import voronoi_cell_areas
from steradian.masks.film_attenuation import attenuation_db
from steradian.masks.weights import resolve_outline

if TYPE_CHECKING:
    from steradian.masks.mask import Mask


@dataclass(frozen=True)
class MaskMetrics:
    """Figures of merit of a mask for one point of interest.

    Attributes
    ----------
    point_of_interest
        x, y, z in metres, or ``None`` for a mask without one (then the figures after ``weight_ratio`` are ``None``).
    spacing
        (M,) distance in metres from each sensor to its nearest neighbour.
    finest, coarsest
        Least and greatest of them.
    weight_ratio
        Largest over smallest weight.
    solid_angles
        (M,) solid angle in steradians (angle in radians for a line) of each sensor's cell within the sensed area, seen
        from the point of interest.
    evenness
        Standard deviation over mean of those that do not touch the aperture's rim.
    largest_angle
        Greatest angle of incidence in radians, at the farthest sensor.
    opening_angle
        Full angle in radians under which the sensors appear, in the widest plane through the point of interest.
    attenuation_db
        What the film loses at ``largest_angle`` and 1 MHz, in dB (:mod:`steradian.masks.film_attenuation`).
    """

    point_of_interest: tuple[float, float, float] | None
    spacing: NDArray[np.float64]
    finest: float
    coarsest: float
    weight_ratio: float
    solid_angles: NDArray[np.float64] | None = None
    evenness: float | None = None
    largest_angle: float | None = None
    opening_angle: float | None = None
    attenuation_db: float | None = None


def evaluate_mask(mask: Mask, point_of_interest: tuple[float, float, float] | None = None) -> MaskMetrics:
    """Compute the metrics of a mask.

    Parameters
    ----------
    mask
        The mask.
    point_of_interest
        x, y, z in metres; ``None`` for the mask's own (the first of several).

    Raises
    ------
    InvalidInput
        When the point of interest is not above the plane.
    """
    spacing = nearest_neighbour_spacing(mask)
    own = mask.points_of_interest
    if point_of_interest is None and len(own):
        point_of_interest = (float(own[0, 0]), float(own[0, 1]), float(own[0, 2]))
    basic = (point_of_interest, spacing, float(spacing.min()), float(spacing.max()), mask.weight_ratio)
    if point_of_interest is None:
        return MaskMetrics(*basic)
    if point_of_interest[2] <= 0:
        raise InvalidInput("point_of_interest", point_of_interest, "z > 0 (m)")
    across = mask.film_positions - np.array(point_of_interest[:2])
    distance = np.hypot(np.linalg.norm(across, axis=1), point_of_interest[2])
    areas = voronoi_cell_areas(mask.positions, resolve_outline(mask))
    angles = areas * point_of_interest[2] / distance ** (2 if mask.is_line else 3)
    largest = float(np.arccos(point_of_interest[2] / distance.max()))
    inner = _interior_points(mask)
    return MaskMetrics(
        *basic,
        solid_angles=angles,
        evenness=float(angles[inner].std() / angles[inner].mean()) if inner.sum() > 1 else None,
        largest_angle=largest,
        opening_angle=_opening_angle(across, point_of_interest[2]),
        attenuation_db=attenuation_db(largest, 1e6),
    )


def nearest_neighbour_spacing(mask: Mask) -> NDArray[np.float64]:
    """Return the distance (M,) in metres of each sensor's nearest neighbour; the aperture for a single sensor."""
    from scipy.spatial import KDTree

    if mask.count == 1:
        return np.full(1, mask.aperture)
    return np.asarray(KDTree(mask.positions).query(mask.positions, k=2)[0])[:, 1]


def spacing_map(mask: Mask, pixels: int = 256) -> NDArray[np.float64]:
    """Return a map over the aperture of the spacing at the nearest sensor (:attr:`MaskMetrics.spacing`).

    Returns
    -------
    ndarray
        (pixels, pixels) [x, y] in metres.

    Raises
    ------
    InvalidInput
        For a line.
    """
    found: NDArray[np.float64] = nearest_neighbour_spacing(mask)[_nearest(mask, pixels)]
    return found


def _nearest(mask: Mask, pixels: int) -> NDArray[np.int64]:
    """Return the index (pixels, pixels) [x, y] of the sensor nearest to each pixel of the aperture."""
    from scipy.spatial import KDTree

    if mask.is_line:
        raise InvalidInput("mask", "a line of sensors", "a mask of a plane")
    centres = ((np.arange(pixels) + 0.5) / pixels - 0.5) * mask.aperture
    x, y = np.meshgrid(centres, centres, indexing="ij")
    nearest = KDTree(mask.positions).query(np.column_stack([x.ravel(), y.ravel()]))[1]
    return np.asarray(nearest, np.int64).reshape(pixels, pixels)


def _opening_angle(across: NDArray[np.float64], depth: float) -> float:
    """Return the largest opening angle in 36 planes through the point of interest, perpendicular to the film."""
    turn = np.arange(36) * (np.pi / 36)
    along = across @ np.vstack([np.cos(turn), np.sin(turn)])
    angles = np.arctan(along.max(axis=0) / depth) - np.arctan(along.min(axis=0) / depth)
    return float(angles.max())


def _interior_points(mask: Mask) -> NDArray[np.bool_]:
    """Return the sensors that are neither on the convex hull nor adjacent to it."""
    from scipy.spatial import KDTree

    focus = mask.points_of_interest[0, :2] if len(mask.points_of_interest) else np.zeros(2)
    radius = np.linalg.norm(mask.film_positions - focus, axis=1)
    to_edge = mask.aperture / 2 - np.abs(mask.positions).max(axis=1)
    gap = np.asarray(KDTree(mask.positions).query(mask.positions, k=min(6, mask.count))[0])
    margin = gap.reshape(mask.count, -1).max(axis=1)
    inner: NDArray[np.bool_] = (to_edge > margin) & (radius < radius.max() - margin)
    return inner
