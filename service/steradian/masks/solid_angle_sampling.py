"""Samples of the sensor plane that are evenly spread in solid angle around points of interest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from steradian.imaging.geometry import polygons as outlines
from steradian.imaging.geometry.polygons import Outline
from steradian.imaging.half_images import morton_order

Array = NDArray[np.float64]
GOLDEN = (1 + 5**0.5) / 2
SAMPLES_PER_POINT = 32
MAX_SAMPLES = 400_000
MIN_SAMPLES_PER_POINT = 8


class Density:
    """Wanted density of sensors: at each place that of the most demanding point of interest.

    Parameters
    ----------
    points
        (P, 3) points of interest x, y, depth in metres.
    outline
        Region to be sensed.
    held
        (M, 2) positions that exist already.
    count
        Number of further positions.
    """

    def __init__(self, points: Array, outline: Outline, held: Array, count: int) -> None:
        self.points = points
        self.total = len(held) + count
        corners = np.linalg.norm(outline[:, None] - points[:, :2], axis=2)
        self.rims = np.arctan(corners.max(axis=0) / points[:, 2])
        self.scale = 1.0  # sensors a steradian; fitted to the samples

    def solid_angle_density(self, places: Array) -> Array:
        """Return the solid angle (N, P) in steradians of a square metre at each place, from each point of interest."""
        across = ((places[:, None] - self.points[:, :2]) ** 2).sum(axis=2)
        found: Array = self.points[:, 2] / (across + self.points[:, 2] ** 2) ** 1.5
        return found

    def spacing(self, places: Array) -> Array:
        """Return the expected distance in metres between neighbours at each place."""
        return np.asarray(1 / np.sqrt(self.scale * self.solid_angle_density(places).max(axis=1)), np.float64)


@dataclass(frozen=True)
class PlaneSamples:
    """Samples of the sensor plane.

    Attributes
    ----------
    places
        (N, 2) metres.
    share
        (N,) number of sensors wanted at each sample; the sum is the total.
    weights
        (N,) for Lloyd's iteration: the square of the wanted density times the sample's area.
    """

    places: Array
    share: Array
    weights: Array


def sample_solid_angles(density: Density, outline: Outline, seed: int) -> PlaneSamples:
    """Sample an outline by Fibonacci lattices on the sphere around each point of interest, projected to the plane.

    Sets the density's scale, so that the number of sensors is the wanted total.
    """
    turns = np.random.default_rng(seed).random(len(density.points))
    each = min(MAX_SAMPLES, max(SAMPLES_PER_POINT, MIN_SAMPLES_PER_POINT) * density.total)
    found, units = [], []
    for (x, y, depth), rim, turn in zip(density.points, density.rims, turns, strict=True):
        cap = 1 - np.cos(rim)
        cosine = 1 - cap * (np.arange(each) + 0.5) / each
        radius = depth * np.sqrt(1 / cosine**2 - 1)
        angle = 2 * np.pi * (np.arange(each) / GOLDEN + turn)
        found.append(np.column_stack([x + radius * np.cos(angle), y + radius * np.sin(angle)]))
        units.append(2 * np.pi * cap / each)
    places = np.concatenate(found)
    places = places[outlines.contains(outline, places)]
    asked = density.solid_angle_density(places)
    area = 1 / (asked / np.array(units)).sum(axis=1)  # of the plane that a sample stands for, m²
    most = asked.max(axis=1)
    density.scale = density.total / float((most * area).sum())
    wanted = density.scale * most
    return PlaneSamples(places, wanted * area, wanted**2 * area)


def stratified_choice(plane: PlaneSamples, held: Array, count: int) -> NDArray[np.int64]:
    """Return the indices of ``count`` samples, evenly spread over the share that held positions leave over.

    Each held position takes up the share of one sensor among the samples nearest to it.
    """
    from scipy.spatial import KDTree

    apart, owner = (np.asarray(each) for each in KDTree(held).query(plane.places))
    order = np.lexsort((apart, owner))
    share = plane.share[order]
    before = np.cumsum(share) - share
    starts = np.flatnonzero(np.diff(owner[order], prepend=-1))
    began = np.repeat(before[starts], np.diff(starts, append=len(order)))
    left = np.empty(len(share))
    left[order] = np.clip(before + share - began - 1.0, 0.0, share)
    curve = morton_order(plane.places)
    reached = np.cumsum(left[curve])
    wanted = (np.arange(count) + 0.5) * (reached[-1] / count)
    chosen = curve[np.minimum(np.searchsorted(reached, wanted), len(curve) - 1)]
    return np.asarray(chosen, np.int64)
