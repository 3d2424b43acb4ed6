"""How alike and how sharp two images are (paper, appendix B)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.errors import InvalidInput


def correlation(a: ArrayLike, b: ArrayLike, mask: ArrayLike | None = None) -> float:
    """Pearson correlation coefficient of two images or volumes.

    Parameters
    ----------
    a, b
        Arrays of one shape.
    mask
        Boolean array of that shape: the region of interest; ``None`` for everywhere.

    Returns
    -------
    float
        Within [−1, 1]; paper, appendix B, equation for ρ.

    Raises
    ------
    InvalidInput
        When the shapes differ, the region has fewer than 2 elements or an image is constant in it.
    """
    first, second = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    if first.shape != second.shape:
        raise InvalidInput("b", f"an array of shape {second.shape}", f"the shape of a, {first.shape}")
    if mask is not None:
        region = np.asarray(mask, dtype=bool)
        if region.shape != first.shape:
            raise InvalidInput("mask", f"an array of shape {region.shape}", f"the shape of a, {first.shape}")
        first, second = first[region], second[region]
    if first.size < 2:
        raise InvalidInput("mask", f"{first.size} elements", "at least 2 elements")
    first, second = first - first.mean(), second - second.mean()
    norm = np.sqrt((first**2).sum() * (second**2).sum())
    if norm == 0:
        raise InvalidInput("a, b", "a constant image", "images that vary within the region")
    return float((first * second).sum() / norm)


def disc(x: NDArray[np.float64], y: NDArray[np.float64], diameter: float) -> NDArray[np.bool_]:
    """Region of interest: a disc around the origin.

    Parameters
    ----------
    x, y
        Coordinates of the image's axes in metres, shapes (Nx,) and (Ny,).
    diameter
        Diameter of the disc in metres.

    Returns
    -------
    ndarray
        Boolean (Nx, Ny).
    """
    inside: NDArray[np.bool_] = x[:, None] ** 2 + y[None, :] ** 2 <= (diameter / 2) ** 2
    return inside
