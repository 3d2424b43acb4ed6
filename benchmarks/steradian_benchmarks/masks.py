"""Benchmark of mask construction, visit orders and previews."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, TypeVar

from steradian.core.progress import Progress
from steradian.masks import Mask, equi_steradian_mask, hexagonal_mask, poisson_disc_mask, random_mask
from steradian.plans import ScanPlan, VisitOrder, path_length, preview
from steradian.plans.tour import nearest_neighbour

APERTURE, DEPTH = 13.56e-3, 3.6e-3
COUNTS = (50, 1600, 51_076, 200_000)
ORDERS = (VisitOrder.SNAKE, VisitOrder.HILBERT, VisitOrder.SHORTEST, VisitOrder.PROGRESSIVE)

Row = dict[str, Any]
Made = TypeVar("Made")


def masks(*, quick: bool = False, progress: Progress | None = None) -> list[Row]:
    """Time the construction of masks and of visit orders.

    Parameters
    ----------
    quick
        Only the smallest sizes.
    progress
        Told after each mask.

    Returns
    -------
    list of dict
        One row a mask and order: seconds, travel in mm and travel over that of nearest neighbour.
    """
    rows: list[Row] = []
    counts = COUNTS[:2] if quick else COUNTS
    for kind in (_equi_steradian, _hexagonal, _random, _poisson_disc):
        kind(50)  # compiled and loaded before the clock runs
    for order in ORDERS:
        _ = ScanPlan.create(mask=_random(50), order=order).visit
    for done, count in enumerate(counts):
        for make in (_equi_steradian, _hexagonal, _random, _poisson_disc):
            mask, seconds = _timed(lambda make=make, count=count: make(count))  # type: ignore[misc]
            name = str(mask.arrangement["arrangement"])
            rows.append({"mask": name, "points": mask.count, "step": "mask", "seconds": seconds})
            if make is _equi_steradian:
                rows += _orders(mask)
        if progress:
            progress("masks", done + 1, len(counts))
    return rows


def _orders(mask: Mask) -> list[Row]:
    nearest = path_length(mask.positions, nearest_neighbour(mask.positions))
    rows: list[Row] = []
    for order in ORDERS:
        cost, seconds = _timed(lambda order=order: preview(ScanPlan.create(mask=mask, order=order)))  # type: ignore[misc]
        row = {"mask": "equi-steradian", "points": mask.count, "step": str(order), "seconds": seconds}
        rows.append(row | {"travel_mm": 1e3 * cost.travel, "over_nearest_neighbour": cost.travel / nearest})
    return rows


def _timed(work: Callable[[], Made]) -> tuple[Made, float]:
    start = time.perf_counter()
    made = work()
    return made, time.perf_counter() - start


def _equi_steradian(count: int) -> Mask:
    return equi_steradian_mask(APERTURE, DEPTH, count)


def _hexagonal(count: int) -> Mask:
    return hexagonal_mask(APERTURE, APERTURE * (1.1547 / count) ** 0.5)


def _random(count: int) -> Mask:
    return random_mask(APERTURE, count)


def _poisson_disc(count: int) -> Mask:
    return poisson_disc_mask(APERTURE, APERTURE * (0.62 / count) ** 0.5)
