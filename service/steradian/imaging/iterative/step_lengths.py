"""Step lengths of least misfit along one direction and two."""

from __future__ import annotations

import numpy as np

from steradian.imaging.volume import RealArray

MIN_STEP, MAX_STEP = 1 / 16, 2.0  # a shorter one would not change what is seen


def optimal_step(residual: RealArray, explained: RealArray) -> float:
    """Return the step length that minimises the residual; 0 if the step explains nothing."""
    size = float(np.vdot(explained, explained))
    return float(np.vdot(residual, explained)) / size if size > 0 else 0.0


def optimal_pair(residual: RealArray, first: RealArray, second: RealArray, alone: float) -> tuple[float, float]:
    """Return the factors of two directions' A-lines that minimise the residual; ``alone`` and 0 if not both of use.

    Of use is a factor from the least step to the longest for the first, and above 0, up to 1, for the second.
    """
    a, b, c = (float(np.vdot(u, v)) for u, v in ((first, first), (first, second), (second, second)))
    determinant = a * c - b * b
    if determinant <= 1e-6 * a * c:
        return alone, 0.0
    p, q = float(np.vdot(residual, first)), float(np.vdot(residual, second))
    length, momentum = (p * c - q * b) / determinant, (q * a - p * b) / determinant
    return (length, momentum) if MIN_STEP <= length <= MAX_STEP and 0 < momentum <= 1 else (alone, 0.0)
