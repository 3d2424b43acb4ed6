"""Relative sensitivity of sensors: validation, and inverse-variance weights for direct methods.

An insensitive sensor has less signal at the same noise. Divided by its sensitivity s its A-line is right and its noise
1/s times as high. Direct methods therefore weight divided A-lines by s², the inverse of their variance, over the mean
of s² in the neighbourhood: its share of the area goes to sensors near it, and amplitudes stay as they are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging.validation import as_float64

SENSITIVITY = (1e-3, 1e3)
"""Least and greatest relative sensitivity; a sensor that is less sensitive is better left out."""
NEIGHBOURS = {1: 5, 2: 13}
"""Sensors of a neighbourhood, the sensor itself included, on a line and on a plane."""


def check_sensitivity(sensitivity: ArrayLike, count: int) -> NDArray[np.float64]:
    """Return the relative sensitivities (M,) of ``count`` sensors.

    Raises
    ------
    InvalidInput
        If there is not one number for each sensor, or one is out of range.
    """
    low, high = SENSITIVITY
    allowed = f"one number a sensor, shape ({count},), each from {low:g} to {high:g}"
    values = as_float64("sensitivity", sensitivity, allowed)
    if values.shape != (count,):
        raise InvalidInput("sensitivity", f"an array of shape {values.shape}", allowed)
    wrong = ~((values >= low) & (values <= high))
    if wrong.any():
        first = int(wrong.argmax())
        raise InvalidInput("sensitivity", f"{values[first]:g} at {first}", allowed)
    return values


def inverse_variance_weights(
    weights: NDArray[np.float64], positions: NDArray[np.float64], sensitivity: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the weights (M,) of A-lines as they were recorded: h·s/⟨s²⟩, the mean taken over neighbours by area h.

    Parameters
    ----------
    weights, positions
        Areas h of the cells in m² and places of the sensors in m, shapes (M,) and (M, d−1).
    sensitivity
        Relative sensitivities s, shape (M,).
    """
    from scipy.spatial import KDTree

    count = min(NEIGHBOURS[positions.shape[1]], len(positions))
    near = KDTree(positions).query(positions, count)[1].reshape(len(positions), count)
    area = weights[near].sum(axis=1)
    mean = (weights[near] * sensitivity[near] ** 2).sum(axis=1)
    factor = sensitivity * np.divide(area, mean, out=np.zeros_like(mean), where=mean > 0)
    return np.asarray(weights * factor, np.float64)
