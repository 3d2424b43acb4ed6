"""Thresholding rule of iterative reconstruction, and the level of streaks at each depth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from steradian.imaging.engines.array_namespace import iter_rows, to_numpy
from steradian.imaging.volume import RealArray

_NORMAL = 1.4826  # standard deviation of normally distributed values over the median of their absolute values
_ENOUGH_VALUES = 3000  # of a depth for its median
_SMOOTH = np.array([1, 2, 3, 2, 1]) / 9  # over depths


def noise_level(values: RealArray) -> NDArray[np.float64]:
    """Estimate the standard deviation of streaks at each depth, shape (Nz,), from the median of absolute values."""
    lateral = tuple(range(values.ndim - 1))
    every = max(1, int((np.prod(values.shape[:-1]) / _ENOUGH_VALUES) ** (1 / len(lateral))))
    thinned = values[(slice(None, None, every),) * len(lateral)]
    return _smooth(_NORMAL * to_numpy(np.median(np.abs(thinned), axis=lateral)))


def rms_per_depth(values: RealArray) -> NDArray[np.float64]:
    """Return the root mean square of the image at each depth, shape (Nz,)."""
    squares = sum(
        to_numpy(np.einsum("...z,...z->...z", part, part).reshape(-1, part.shape[-1]).sum(axis=0))
        for part in iter_rows(values)
    )
    return _smooth(np.sqrt(squares / np.prod(values.shape[:-1])))


def shrink(values: RealArray, cut: RealArray, *, non_negative: bool) -> None:
    """Apply the thresholding rule v·(1 − (c/|v|)^1.5) in place, 0 below c; row by row to save memory.

    ``cut`` (Nz,) is c at each depth. Negative values become 0 if ``non_negative``.
    """
    least = np.maximum(cut, np.finfo(values.dtype).tiny)
    for part in iter_rows(values):
        if non_negative:
            np.maximum(part, 0, out=part)
        ratio = np.maximum(np.abs(part), least)
        np.divide(cut, ratio, out=ratio)
        ratio *= np.sqrt(ratio)
        np.subtract(1, ratio, out=ratio)
        part *= ratio


def _smooth(levels: RealArray) -> NDArray[np.float64]:
    return np.convolve(np.pad(levels, len(_SMOOTH) // 2, mode="edge"), _SMOOTH, "valid")
