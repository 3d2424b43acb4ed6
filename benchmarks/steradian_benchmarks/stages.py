"""Benchmark of scans in stages: a survey and a focus beside masks made beforehand, on objects at random places."""

from __future__ import annotations

from typing import Any

import numpy as np

from steradian.comparisons import Simulation, StagedScan, phantom
from steradian.core.progress import Progress
from steradian.imaging import Volume, VoxelAxes
from steradian.masks import Mask, equi_steradian_mask, grid_mask, nearest_square
from steradian.phantoms import Balls, rasterise
from steradian.quality.points_of_interest import find_points_of_interest

APERTURE, GUESS = 13.56e-3, 3.6e-3
"""Side of the aperture, and depth at which a person guesses the object, in m."""
RADIUS, REGION = 1.2e-3, 3.2e-3
"""Radius of the vessels and diameter of the region around their middle, in m."""
DEPTHS = (2e-3, 4e-3)
COUNTS = {1600: 200, 500: 120}
"""Numbers of points, and those of the survey among them."""
PLACES, FIRST_SEED = 10, 100
ITERATIONS = 10
"""Of the iterative method; 30 change no correlation by more than 0.002."""
NEAR = 0.5e-3
"""Greatest distance in m of a found place from the object's brightest one."""
TRUTH_VOXEL = 60e-6
MASKS = {
    "guess": "equi-steradian at the middle, 3.6 mm",
    "grid": "grid",
    "staged": "survey, then focus",
    "true": "equi-steradian at the true place",
}
Row = dict[str, Any]


def stages(*, quick: bool = False, progress: Progress | None = None) -> list[Row]:
    """Image vessels at random places through masks made beforehand and through scans in stages.

    Parameters
    ----------
    quick
        One place with few points, and no iterative method.
    progress
        Called after each place.

    Returns
    -------
    list of dict
        One row a place, depth and number of points: the found place, its distance in m from the object's brightest
        place, and the correlation of each mask's direct and iterative volume with the object.
    """
    cases = [
        (count, survey, depth, seed)
        for count, survey in ({300: 120} if quick else COUNTS).items()
        for depth in DEPTHS[: 1 if quick else 2]
        for seed in range(FIRST_SEED, FIRST_SEED + (1 if quick else PLACES))
    ]
    rows = []
    for done, (count, survey, depth, seed) in enumerate(cases):
        rows.append(_case(count, survey, depth, seed, iterations=0 if quick else ITERATIONS))
        if progress:
            progress("places", done + 1, len(cases))
    return rows


def _case(count: int, survey: int, depth: float, seed: int, *, iterations: int) -> Row:
    """Return the row of one object."""
    place = random_place(depth, seed)
    vessels = phantom("vessel-tree", place, RADIUS, seed=seed)
    simulation = Simulation(vessels, place[:2], REGION, iterations=iterations, seed=seed)
    staged, found = StagedScan(APERTURE, count, survey, seed).build(simulation)
    side = nearest_square(count)
    masks: dict[str, Mask] = {
        "guess": equi_steradian_mask(APERTURE, GUESS, count),
        "grid": grid_mask(APERTURE, side, APERTURE / side, centred=True),
        "staged": staged,
        "true": equi_steradian_mask(APERTURE, depth, count, offset=place[:2]),
    }
    row: Row = {"part": "focus", "points": count, "survey": survey, "depth_m": depth, "seed": seed, "place_m": place}
    row |= {
        "found_m": found.position if found else None,
        "signal_to_noise": found.signal_to_noise if found else None,
        "distance_m": float(np.linalg.norm(np.subtract(found.position, brightest_place(vessels)))) if found else None,
        "from_middle_m": float(np.linalg.norm(np.subtract(found.position, place))) if found else None,
    }
    for name, mask in masks.items():
        outcome = simulation.simulate(mask)
        row[f"{name}_points"] = mask.count
        for method, correlation in outcome.by.items():
            row[f"{name}_{method}"] = correlation.around
            row[f"{name}_{method}_mip"] = correlation.around_mip
    return row


def random_place(depth: float, seed: int) -> tuple[float, float, float]:
    """Return a place at a depth in metres whose region lies over the aperture."""
    reach = (APERTURE - REGION) / 2
    x, y = np.random.default_rng([seed, round(1e6 * depth)]).uniform(-reach, reach, 2)
    return float(x), float(y), depth


def brightest_place(balls: Balls) -> tuple[float, float, float]:
    """Return the place that the search finds in the object itself instead of an image."""
    margin = 1.5e-3
    low, high = balls.centres.min(axis=0) - margin, balls.centres.max(axis=0) + margin
    x, y, z = (np.arange(a, b, TRUTH_VOXEL) for a, b in zip(low, high, strict=True))
    empty = np.zeros((len(x), len(y), len(z)), np.float32)
    like = Volume(empty, VoxelAxes(x, y, z), (TRUTH_VOXEL,) * 3)
    depths = (max(0.0, float(low[2])), float(high[2]))
    return find_points_of_interest(rasterise(balls, like), least_signal_to_noise=1e-6, depth=depths)[0].position


def summary(rows: list[Row]) -> list[Row]:
    """Return one row for each number of points, depth and mask: mean and worst correlations."""
    found: list[Row] = []
    for count, depth in dict.fromkeys((row["points"], row["depth_m"]) for row in rows):
        own = [row for row in rows if (row["points"], row["depth_m"]) == (count, depth)]
        for name, title in MASKS.items():
            line: Row = {"points": count, "depth_mm": 1e3 * depth, "mask": title}
            for method in ("direct", "iterative"):
                values = [row[f"{name}_{method}"] for row in own if f"{name}_{method}" in row]
                if values:
                    line |= {f"{method}_mean": float(np.mean(values)), f"{method}_worst": float(np.min(values))}
            found.append(line)
    return found


def found_share(rows: list[Row]) -> float:
    """Return the share of places found within 0.5 mm of the object's brightest place."""
    return float(np.mean([row["distance_m"] is not None and row["distance_m"] <= NEAR for row in rows]))


def violations(rows: list[Row]) -> list[str]:
    """Return one line for each claim that does not hold."""
    lines = []
    if found_share(rows) < 0.95:
        lines.append(f"found within 0.5 mm: {found_share(rows):.0%}, below 95 %")
    table = {(row["points"], row["depth_mm"], row["mask"]): row for row in summary(rows)}
    for (count, depth, mask), row in table.items():
        if mask == MASKS["staged"]:
            true = table[count, depth, MASKS["true"]]["direct_mean"]
            if row["direct_mean"] < true - 0.01:
                lines.append(f"{count} points, {depth:g} mm: {row['direct_mean']:.3f}, below {true:.3f} − 0.01")
    return lines
