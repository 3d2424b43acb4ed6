"""Experiment: design of a mask by gradient descent on the expected error of the iterative method.

The object is a set of small balls with independent random amplitudes in a region around the point of interest, the
noise is white. The expected error of the best linear estimate is then tr (I + Σ_m A_mᵀA_m/σ²)⁻¹, with A_m (N_t, K) the
balls' A-lines at sensor m in closed form (A-optimal design). Its gradient moves each sensor; the mask that results is
compared with others on objects of another kind.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.comparisons import Simulation, phantom
from steradian.core.progress import Progress
from steradian.masks import Mask, custom_mask, equi_steradian_mask, grid_mask, poisson_disc_mask

APERTURE, POINT = 6e-3, (0.8e-3, -0.5e-3, 1.5e-3)
COUNTS = (100, 225)
RADIUS, REGION = 0.6e-3, 1.4e-3
"""Radius of the region in which the balls lie and of the objects, and diameter of the region judged, in m."""
BALLS, SIGMA = 1000, 60e-6
INTERVAL, SPEED = 24e-9, 1500.0
NOISE_RATIO = 0.1
"""Standard deviation of the noise over a ball's peak pressure at the point right above it."""
STEPS, DIFFERENCE = 40, 5e-6
FIRST_STEP = 120e-6
OBJECTS, ITERATIONS, MODES = 5, 30, 100
Array = NDArray[np.float64]
Row = dict[str, Any]


def design_by_gradient(*, quick: bool = False, progress: Progress | None = None) -> list[Row]:
    """Compare masks optimised by gradient with others: expected error, and correlations of iterative images.

    Returns
    -------
    list of dict
        One row a number of points and mask: ``expected_error`` of the balls (1: nothing known), and mean and worst
        correlation of volumes with vessels and with yarns around the point of interest.
    """
    rows = []
    for count in COUNTS[: 1 if quick else 2]:
        masks = _masks(count, steps=2 if quick else STEPS, progress=progress)
        for name, mask in masks.items():
            row: Row = {"points": mask.count, "mask": name, "expected_error": _error(mask.positions, _balls(1))[0]}
            for kind in ("vessel-tree", "yarn"):
                found = [_correlation(mask, kind, seed) for seed in range(1 if quick else OBJECTS)]
                row |= {f"{kind}_mean": float(np.mean(found)), f"{kind}_worst": float(np.min(found))}
            rows.append(row)
    return rows


def _masks(count: int, *, steps: int, progress: Progress | None) -> dict[str, Mask]:
    side = round(count**0.5)
    masks = {
        "equi-steradian": equi_steradian_mask(APERTURE, POINT[2], count, offset=POINT[:2]),
        "grid": grid_mask(APERTURE, side, APERTURE / side, centred=True),
        "poisson-disc": poisson_disc_mask(APERTURE, count=count),
    }
    for start in ("equi-steradian", "grid"):
        places = optimise(masks[start].positions, steps=steps, progress=progress)
        masks[f"optimised from {start}"] = custom_mask(places, APERTURE)
    return masks


def optimise(places: Array, *, steps: int = STEPS, progress: Progress | None = None) -> Array:
    """Return sensor positions moved down the gradient of the expected error, with a step that adapts."""
    balls, best = _balls(0), places.copy()
    error, slope = _error(best, balls)
    step = FIRST_STEP
    for number in range(steps):
        scale = np.sqrt((slope**2).sum(axis=1).mean())
        moved = np.clip(best - step * slope / scale, -APERTURE / 2, APERTURE / 2)
        tried, steep = _error(moved, balls)
        if tried < error:
            best, error, slope, step = moved, tried, steep, 1.3 * step
        else:
            step /= 3
        if progress:
            progress("steps", number + 1, steps)
    return np.asarray(best, np.float64)


def _balls(seed: int) -> Array:
    """Return the centres (K, 3) of the balls in metres, uniformly distributed in the region."""
    random = np.random.default_rng(seed)
    directions = random.normal(size=(BALLS, 3))
    radius = RADIUS * random.random(BALLS) ** (1 / 3)
    units = directions / np.linalg.norm(directions, axis=1)[:, None]
    return np.asarray(POINT + units * radius[:, None], np.float64)


def _error(places: Array, balls: Array) -> tuple[float, Array]:
    """Return the expected error over that without data, and its gradient (M, 2) by the sensors' positions."""
    level = NOISE_RATIO * SIGMA / POINT[2] * np.exp(-0.5) / 2
    stacked = np.concatenate([_alines(place, balls, _reach(place, balls)) for place in places])
    inverse = np.linalg.inv(np.eye(BALLS) + stacked.T @ stacked / level**2)
    squared = inverse @ inverse
    slope = np.empty_like(places)
    for number, place in enumerate(places):
        reach = _reach(place, balls)
        weighted = _alines(place, balls, reach) @ squared
        for axis in (0, 1):
            shift = np.zeros(2)
            shift[axis] = DIFFERENCE
            change = _alines(place + shift, balls, reach) - _alines(place - shift, balls, reach)
            slope[number, axis] = -float((weighted * change).sum()) / DIFFERENCE / level**2 / BALLS
    return float(np.trace(inverse)) / BALLS, slope


def _distances(place: Array, balls: Array) -> Array:
    return np.asarray(np.sqrt(((balls[:, :2] - place) ** 2).sum(axis=1) + balls[:, 2] ** 2), np.float64)


def _reach(place: Array, balls: Array) -> Array:
    """Return the distances (N_t,) in metres that sound has come at the samples in which a sensor hears the balls."""
    distance, step = _distances(place, balls), INTERVAL * SPEED
    first, last = (distance.min() - 4 * SIGMA) // step, (distance.max() + 4 * SIGMA) // step + 1
    return np.asarray(step * np.arange(first, last + 1), np.float64)


def _alines(place: Array, balls: Array, reach: Array) -> Array:
    """Return the A-lines (N_t, K) of Gaussian balls of peak pressure 1 at one sensor."""
    distance = _distances(place, balls)
    late = distance - reach[:, None]
    return np.asarray(late / (2 * distance) * np.exp(-((late / SIGMA) ** 2) / 2), np.float64)


def _correlation(mask: Mask, kind: str, seed: int) -> float:
    """Return the correlation of the iterative volume with an object around the point of interest."""
    thing = phantom(kind, POINT, RADIUS, seed=seed)
    simulation = Simulation(thing, POINT[:2], REGION, modes=MODES, iterations=ITERATIONS, seed=seed)
    return simulation.simulate(mask).by["iterative"].around


if __name__ == "__main__":
    print(json.dumps(design_by_gradient(), indent=2))
