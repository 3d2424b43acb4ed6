"""Quadrature weights: area represented by each sensor.

Sensors cover an outline, the *sensed* area, which need not be the reconstruction's aperture: h_m is the area of sensor
m's Voronoi cell within it, so the sum over sensors is an integral over what was sensed and the image has the object's
amplitude, as far as that area lets it be seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging.geometry import polygons as outlines
from steradian.imaging.geometry.polygons import Outline
from steradian.imaging.geometry.voronoi import voronoi_cell_areas

_SAME_LINE = 1e-5
"""Coordinates that differ by less than this share of the extent are of one line of a grid."""
_OFF_GRID = 0.01
"""So many intervals a sensor of a grid may lie beside its place."""
COINCIDENT_TOLERANCE = 1e-9
"""Sensors that are no farther apart than this share of the aperture are at one place; so are a grid's lines, of its
longer side."""


@dataclass(frozen=True)
class SensorGrid:
    """Rectangular grid of sensors.

    Attributes
    ----------
    counts, pitch
        Places for sensors and their interval in metres along each axis.
    first
        Lowest coordinates in metres.
    """

    counts: NDArray[np.int64]
    pitch: NDArray[np.float64]
    first: NDArray[np.float64]

    @property
    def outline(self) -> Outline:
        """Rectangle of all grid cells, half an interval beyond the outermost sensors."""
        return outlines.rectangle(self.first - self.pitch / 2, self.first + (self.counts - 0.5) * self.pitch)


def detect_sensor_grid(points: NDArray[np.float64], *, filled: float = 1.0) -> SensorGrid | None:
    """Return the rectangular grid formed by points (M, d), at least 2 by 2 and each node once; None if there is none.

    ``filled`` is the share of its places that must have a point; ``None`` where there is no such grid.
    """
    first, places = points.min(axis=0), []
    pitch = np.empty(points.shape[1])
    for axis, line in enumerate(points.T):
        ranked = np.sort(line)
        gaps = np.diff(ranked)
        steps = gaps[gaps > _SAME_LINE * np.ptp(line)]
        if not len(steps):
            return None
        pitch[axis] = np.ptp(line) / np.rint(steps / steps.min()).sum()
        place = (line - first[axis]) / pitch[axis]
        places.append(np.rint(place).astype(np.int64))
        if np.abs(place - places[-1]).max() > _OFF_GRID:
            return None
    if pitch.min() <= COINCIDENT_TOLERANCE * np.ptp(points, axis=0).max():
        return None
    counts = np.array([place.max() + 1 for place in places])
    if not filled * float(counts.prod(dtype=np.float64)) <= len(points) <= counts.prod(dtype=np.float64):
        return None
    if len(np.unique(np.ravel_multi_index(tuple(places), tuple(counts)))) != len(points):
        return None
    return SensorGrid(counts, pitch, first)


def sensed_region(positions: NDArray[np.float64], aperture: float | Sequence[float]) -> Outline:
    """Return the outline of the area covered by sensors, from their positions alone.

    Parameters
    ----------
    positions
        (M, 2) metres, or (M, 1) on a line.
    aperture
        Side lengths in metres, one number or one an axis.

    Returns
    -------
    ndarray
        Of sensors that fill a rectangular grid, their cells of pitch × pitch: N·pitch along an axis. Of others, all
        that is within half a mean spacing s of their convex hull, where the outline's area is M·s²; but no wider than
        the aperture, and the whole aperture for sensors at one place.
    """
    sides = np.broadcast_to(np.asarray(aperture, np.float64), positions.shape[1:])
    low, high = positions.min(axis=0), positions.max(axis=0)
    if (high - low).max() <= COINCIDENT_TOLERANCE * sides.max():
        return outlines.rectangle(-sides / 2, sides / 2)
    lattice = detect_sensor_grid(positions)
    if lattice is not None:
        return lattice.outline
    bare = outlines.convex_hull(positions)
    count = _number_of_places(positions)
    outline = outlines.buffered_hull(bare, _mean_spacing(bare, count) / 2)
    middle, half = (low + high) / 2, np.maximum(sides, high - low) / 2
    return outlines.intersection(outline, outlines.rectangle(middle - half, middle + half))


def _number_of_places(positions: NDArray[np.float64]) -> int:
    return len(np.unique(np.round(positions / (COINCIDENT_TOLERANCE * np.ptp(positions, axis=0).max())), axis=0))


def _mean_spacing(bare: Outline, count: int) -> float:
    """Return the mean spacing s that solves M·s² = A + P·s/2 + π·s²/4, for a hull of area A and perimeter P."""
    if bare.shape[1] == 1:
        return outlines.area(bare) / (count - 1)
    inside = max(0.0, outlines.area(bare)) if len(bare) > 2 else 0.0
    half = np.linalg.norm(np.roll(bare, -1, axis=0) - bare, axis=1).sum() / 4
    lead = count - np.pi / 4
    return float((half + np.sqrt(half**2 + lead * inside)) / lead)


def sensor_areas(positions: NDArray[np.float64], aperture: float | Sequence[float]) -> NDArray[np.float64]:
    """Return the areas of the sensors' cells within :func:`sensed_region`, (M,) in m² (m on a line).

    Those of a grid are equal and cost a sort along each axis; else Voronoi cells are drawn (0.5 s and 100 MB for fifty
    thousand sensors, about proportional).
    """
    outline = sensed_region(positions, aperture)
    lattice = detect_sensor_grid(positions)
    if lattice is not None:
        return np.full(len(positions), outlines.area(outline) / len(positions))
    return voronoi_cell_areas(positions, outline)


def voronoi_weights(positions: ArrayLike, aperture: float | tuple[float, ...]) -> NDArray[np.float64]:
    """Return the areas of the sensors' Voronoi cells within their outline, as ``weights=None`` and "voronoi" do.

    Parameters
    ----------
    positions
        Shape (M, 2), or (M,) on a line, in metres. Sensors at the same place share their cell.
    aperture
        Side lengths in metres, one number or one an axis; cells reach no farther.

    Returns
    -------
    ndarray
        h, shape (M,), in m² (m on a line); Σ h is the sensed area (:func:`sensed_region`).

    Raises
    ------
    InvalidInput
        If there is no sensor, or one is not finite.
    """
    x = np.array(positions, np.float64)
    x = x[:, None] if x.ndim == 1 else x
    if x.ndim != 2 or x.shape[1] not in (1, 2) or not len(x) or not np.isfinite(x).all():
        raise InvalidInput("positions", f"an array of shape {np.shape(positions)}", "finite (M, 2), or (M,) on a line")
    return sensor_areas(x, aperture)
