"""Sensing spots by integration: A-lines of points all over the spot, averaged by Gaussian quadrature.

Independent of the reconstruction, which multiplies spectra.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput


def averaged_over_spot(
    simulate: Callable[[NDArray[np.float64]], NDArray[Any]],
    positions: ArrayLike,
    *,
    diameter: float,
    profile: str = "gaussian",
    radii: int = 6,
    angles: int = 12,
) -> NDArray[np.float64]:
    """Return A-lines averaged over a sensing spot around each position.

    Parameters
    ----------
    simulate
        A-lines (M, N_t) of point sensors at (M, 2) positions.
    positions
        (M, 2) centres of the spots, in m.
    diameter
        Of a top hat, or the 1/e² diameter of a Gaussian beam, in m.
    profile
        "gaussian" or "top-hat".
    radii, angles
        Points of the quadrature over the radius, and at each radius.

    Returns
    -------
    Array (M, N_t), as many simulations as there are points of the quadrature.

    Raises
    ------
    InvalidInput
        When the profile is unknown.
    """
    if profile == "top-hat":  # the area rises evenly with r²
        nodes, weights = np.polynomial.legendre.leggauss(radii)
        distances, weights = diameter / 2 * np.sqrt((nodes + 1) / 2), weights / 2
    elif profile == "gaussian":  # e^{−x} with x = 2r²/w²
        nodes, weights = np.polynomial.laguerre.laggauss(radii)
        distances = diameter / 2 * np.sqrt(nodes / 2)
    else:
        raise InvalidInput("profile", profile, "gaussian, top-hat")
    where = np.asarray(positions, np.float64)
    total: Any = 0.0
    for number, (distance, weight) in enumerate(zip(distances, weights, strict=True)):
        for turn in (np.arange(angles) + 0.5 * (number % 2)) * (2 * np.pi / angles):
            offset = distance * np.array([np.cos(turn), np.sin(turn)])
            total = total + weight / angles * simulate(where + offset)
    return np.asarray(total, np.float64)
