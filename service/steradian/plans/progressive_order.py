"""Progressive visit order: the points after each pass form a sparse, uniform mask.

Points are eliminated from the mask one by one, always the one most crowded by those that are left (C. Yuksel, "Sample
elimination for generating Poisson disk sample sets", 2015), until half are left, then a quarter and so on. Crowding
is measured between directions from the point of interest, where an equi-steradian mask is even, else in the plane in
units of each point's own share.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from steradian.masks import Mask

PASSES = 4
"""The first pass measures an eighth of the points, the second another eighth, then a quarter, then a half."""
NEIGHBOUR_RADIUS = 2.25
"""Distances within which points crowd each other; at 2 the first pass leaves pairs 0.55 of a spacing apart."""
MIN_POINTS = 16
"""No pass but the only one has fewer points."""


@dataclass(frozen=True)
class Progressive:
    """Progressive visit order and the ends of its passes.

    Attributes
    ----------
    visit
        (M,) indices in the order of interrogation.
    ends
        Number of points measured at the end of each pass; the last is M.
    """

    visit: NDArray[np.int64]
    ends: tuple[int, ...]


def progressive(positions: NDArray[np.float64], mask: Mask | None = None) -> Progressive:
    """Return an order in passes that double in size, each prefix uniform and each pass on a short tour.

    Parameters
    ----------
    positions
        (M, 2) metres.
    mask
        Their mask, for its point of interest and weights; ``None``: even in the plane.
    """
    from steradian.plans.tour import concatenate, short_tour

    left = np.arange(len(positions))
    space = _density_coordinates(positions, mask)
    passes = []
    for _ in range(PASSES - 1):
        half = (len(left) + 1) // 2
        if half < 2 * MIN_POINTS:
            break
        kept = _eliminate(space[left], half)
        passes.append(left[~kept])
        left = left[kept]
    passes = [left, *passes[::-1]]
    visit = concatenate(positions, [part[short_tour(positions[part])] for part in passes])
    return Progressive(visit, tuple(np.cumsum([len(part) for part in passes]).tolist()))


def _density_coordinates(positions: NDArray[np.float64], mask: Mask | None) -> NDArray[np.float64]:
    """Return coordinates (M, 2 … 4) in which the mask has uniform density of 1."""
    if mask is not None and mask.is_line:
        place = np.argsort(np.argsort(positions[:, 0], kind="stable"), kind="stable")
        return np.column_stack([place, np.zeros(len(place))]).astype(np.float64)
    focus = np.empty((0, 3)) if mask is None else mask.points_of_interest
    if mask is None or not len(focus):
        spread = np.maximum(np.ptp(positions, axis=0), 1e-30)
        return positions * sqrt(len(positions) / float(np.prod(spread)))
    rays = np.concatenate([positions, np.zeros((len(positions), 1))], axis=1)[None] - focus[:, None]
    distance = np.linalg.norm(rays, axis=2)
    nearest, each = distance.argmin(axis=0), np.arange(len(positions))
    rays, distance, depth = rays[nearest, each], distance[nearest, each], focus[nearest, 2]
    unit = mask.weights * depth / distance**3  # solid angle of each point
    scaled = np.empty((len(positions), 4))
    for index in range(len(focus)):
        own = nearest == index
        if own.any():
            scaled[own, :3] = (rays[own] / distance[own, None]) / np.sqrt(np.median(unit[own]))
            scaled[own, 3] = 1e3 * index  # points of different points of interest do not crowd each other
    return scaled


def _eliminate(space: NDArray[np.float64], wanted: int) -> NDArray[np.bool_]:
    """Return which ``wanted`` points remain after repeated removal of the most crowded point.

    A neighbour at distance d adds (1 − d/(NEIGHBOUR_RADIUS·r))⁸ to the crowding, where r is the distance in an ideal
    hexagonal arrangement of the remaining points.
    """
    from scipy.spatial import KDTree

    from steradian.plans.sample_elimination import eliminate_samples

    reach = NEIGHBOUR_RADIUS * sqrt(len(space) / wanted / (2 * sqrt(3)))
    pairs = KDTree(space).query_pairs(reach, output_type="ndarray")
    distance = np.linalg.norm(space[pairs[:, 0]] - space[pairs[:, 1]], axis=1)
    crowding = np.maximum(1 - distance / reach, 0) ** 8
    ends = np.concatenate([pairs, pairs[:, ::-1]])
    order = np.argsort(ends[:, 0], kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(ends[:, 0], minlength=len(space)))])
    kept: NDArray[np.bool_] = eliminate_samples(starts, ends[order, 1], np.tile(crowding, 2)[order], wanted)
    return kept
