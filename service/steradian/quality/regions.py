"""Regions of interest for image comparison."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput

Region = NDArray[np.bool_]


def disc(
    x: NDArray[np.float64], y: NDArray[np.float64], diameter: float, centre: tuple[float, float] = (0.0, 0.0)
) -> Region:
    """Return the region of interest of a disc, as boolean array.

    Parameters
    ----------
    x, y
        Coordinates of the image's axes in metres, shapes (Nx,) and (Ny,).
    diameter
        Diameter of the disc in metres.
    centre
        Its middle, in metres.

    Returns
    -------
    ndarray
        Boolean (Nx, Ny).
    """
    inside: Region = (x[:, None] - centre[0]) ** 2 + (y[None, :] - centre[1]) ** 2 <= (diameter / 2) ** 2
    return inside


def above_threshold(reference: ArrayLike, threshold: float = 0.04) -> Region:
    """Return the region of elements above a fraction of the reference's maximum (paper, section 6).

    Parameters
    ----------
    reference
        Projection or volume of any shape.
    threshold
        Share of its maximum, 0 to 1.

    Returns
    -------
    ndarray
        Boolean, of the shape of the reference.

    Raises
    ------
    InvalidInput
        When the threshold is out of range or the reference has no positive element.
    """
    values = np.asarray(reference)
    if not 0 <= threshold <= 1:
        raise InvalidInput("threshold", threshold, "0 to 1, a share of the reference's maximum")
    peak = values.max() if values.size else 0.0
    if not peak > 0:
        raise InvalidInput("reference", f"maximum {peak:g}", "an image with a positive maximum")
    inside: Region = values >= threshold * peak
    return inside


def bounding_slices(region: ArrayLike) -> tuple[slice, ...]:
    """Return the bounding box of a region, as a slice an axis.

    Raises
    ------
    InvalidInput
        When the region is empty.
    """
    inside = np.asarray(region, dtype=bool)
    if not inside.any():
        raise InvalidInput("region", "empty", "at least one element")
    slices = []
    for axis in range(inside.ndim):
        others = tuple(other for other in range(inside.ndim) if other != axis)
        found = np.flatnonzero(inside.any(axis=others))
        slices.append(slice(int(found[0]), int(found[-1]) + 1))
    return tuple(slices)


def same_shape(name: str, array: NDArray[Any], expected: tuple[int, ...], of: str) -> None:
    """Raise ``InvalidInput`` unless ``array`` has the shape of the other one."""
    if array.shape != expected:
        raise InvalidInput(name, f"an array of shape {array.shape}", f"the shape of {of}, {expected}")
