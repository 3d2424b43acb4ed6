"""Three-dimensional phantom of a branching tree of vessels, composed of Gaussian balls."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fabry_perot.simulator.phantoms import Balls

Array = NDArray[np.float64]
_STEP = 1.0  # distance of neighbouring balls in units of their s
_SHRINK = 2 ** (-1 / 3)  # Murray's law for two equal branches


def vessels(
    seed: int = 0,
    *,
    centre: tuple[float, float, float] = (0.0, 0.0, 3.6e-3),
    radius: float = 3.5e-3,
    generations: int = 6,
    thickest: float = 110e-6,
) -> Balls:
    """Return a phantom of a vessel that branches repeatedly within a flat region.

    Parameters
    ----------
    seed
        Varies lengths, angles and bends.
    centre
        Middle of the region, in m.
    radius
        Its lateral radius in m; it is less than half as deep.
    generations
        Levels of branching; branches end where they leave the region.
    thickest
        s of the root in m; each branching thins by 2^(−1/3) (Murray's law).

    Returns
    -------
    Balls
        Of s from ``thickest`` down, one s apart along each vessel; amplitudes make each vessel's axis about 1.
    """
    random = np.random.default_rng([seed, 11])
    region = radius * np.array([1.0, 1.0, 0.45])
    paths: list[Array] = []
    front = [(np.array([-radius, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))]
    sigmas: list[Array] = []
    for generation in range(generations):
        s = thickest * _SHRINK**generation
        following = []
        for origin, direction in front:
            length = radius * 0.62 * 0.82**generation * random.uniform(0.8, 1.2)
            path, end = _curved_path(random, origin, direction, length, s)
            inside = ((path / region) ** 2).sum(axis=1) <= 1.05
            paths.append(path[inside])
            sigmas.append(np.full(int(inside.sum()), s))
            if inside[-1]:
                following += [(path[-1], _rotated(random, end, side * random.uniform(0.35, 0.75))) for side in (-1, 1)]
        front = following
    widths = np.concatenate(sigmas)
    return Balls(np.concatenate(paths) + np.asarray(centre), widths, np.full(len(widths), _STEP / np.sqrt(2 * np.pi)))


def _curved_path(
    random: np.random.Generator, origin: Array, direction: Array, length: float, s: float
) -> tuple[Array, Array]:
    """Return the points of a gently curved path at a spacing of one s, and the direction at its end."""
    count = max(2, int(length / (_STEP * s)))
    bend = random.normal(size=3) * np.array([0.5, 0.5, 0.3]) / length
    points, at, heading = [], origin, direction
    for _ in range(count):
        heading = heading + bend * (length / count)
        heading = heading / np.linalg.norm(heading)
        at = at + heading * (length / count)
        points.append(at)
    return np.array(points), heading


def _rotated(random: np.random.Generator, direction: Array, angle: float) -> Array:
    """Return the direction rotated about the depth axis, with a random tilt."""
    c, s = np.cos(angle), np.sin(angle)
    turned = np.array(
        [c * direction[0] - s * direction[1], s * direction[0] + c * direction[1], direction[2] + random.normal(0, 0.2)]
    )
    unit: Array = turned / np.linalg.norm(turned)
    return unit
