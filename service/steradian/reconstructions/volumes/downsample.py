"""Downsampling of a volume by 2 along each axis (mean of 2×2×2 voxels)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.jit import jit


def downsample(values: NDArray[Any]) -> NDArray[np.floating[Any]]:
    """Return a volume downsampled by 2 along each axis (means of 2×2×2 voxels) as a floating-point array.

    Voxels without a value (NaN) are left out of the means.
    """
    values = values.astype(np.result_type(values, np.float32), copy=False)  # in this machine's order of bytes
    found = _means(values)
    if (gaps := np.isnan(found)).any():
        there = ~np.isnan(values)
        with np.errstate(invalid="ignore"):  # nothing of nothing is no value
            found[gaps] = (_means(np.where(there, values, 0)) / _means(there.astype(values.dtype)))[gaps]
    return found


def _means(values: NDArray[Any]) -> NDArray[np.floating[Any]]:
    found = np.empty([-(-size // 2) for size in values.shape], values.dtype)
    mean_pool(values, found, values.dtype.type(0.5))
    return found


@jit
def mean_pool(values, found, half):  # type: ignore[no-untyped-def]
    """Write the means of 2×2×2 voxels into the array ``found``; compiled by numba."""
    nx, ny, nz = values.shape
    row = np.empty(nz, values.dtype)
    for i in range(found.shape[0]):
        for j in range(found.shape[1]):
            last_i, last_j = min(2 * i + 1, nx - 1), min(2 * j + 1, ny - 1)
            # the mean of four rows, of which some are the same one at an edge
            a, b = values[2 * i, 2 * j], values[2 * i, last_j]
            c, d = values[last_i, 2 * j], values[last_i, last_j]
            for k in range(nz):
                row[k] = half * half * (a[k] + b[k] + c[k] + d[k])
            for k in range(nz // 2):
                found[i, j, k] = half * (row[2 * k] + row[2 * k + 1])
            if nz % 2:
                found[i, j, nz // 2] = row[nz - 1]
