"""Pearson correlation of images and volumes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.quality.regions import same_shape

_BLOCK = 1 << 21
"""Elements of a volume worked on together: their float64 copies stay small beside the volume."""


def correlation(a: ArrayLike, b: ArrayLike, mask: ArrayLike | None = None) -> float:
    """Return the Pearson correlation coefficient of two images or volumes.

    Sums run in float64 over blocks, so volumes of any size need no copies.

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
    first, second = np.asarray(a), np.asarray(b)
    same_shape("b", second, first.shape, "a")
    region = None if mask is None else np.asarray(mask, dtype=bool)
    if region is not None:
        same_shape("mask", region, first.shape, "a")
    count = first.size if region is None else int(region.sum())
    if count < 2:
        raise InvalidInput("mask", f"{count} elements", "at least 2 elements")
    sums = sum((np.array([u.sum(), v.sum()]) for u, v in _blocks(first, second, region)), np.zeros(2))
    means = sums / count
    products = np.zeros(3)
    for u, v in _blocks(first, second, region):
        du, dv = u - means[0], v - means[1]
        products += np.array([np.vdot(du, dv), np.vdot(du, du), np.vdot(dv, dv)])
    norm = np.sqrt(products[1]) * np.sqrt(products[2])
    if norm == 0:
        raise InvalidInput("a, b", "a constant image", "images that vary within the region")
    return float(np.clip(products[0] / norm, -1.0, 1.0))


def _blocks(
    a: NDArray[np.generic], b: NDArray[np.generic], region: NDArray[np.bool_] | None
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Yield the region's elements of both arrays as float64 vectors, in blocks of rows of the first axis."""
    a, b = np.atleast_1d(a), np.atleast_1d(b)
    rows = max(1, _BLOCK // max(1, a[0].size))
    for start in range(0, len(a), rows):
        some = slice(start, start + rows)
        pick = slice(None) if region is None else np.atleast_1d(region)[some]
        yield a[some][pick].astype(np.float64).ravel(), b[some][pick].astype(np.float64).ravel()
