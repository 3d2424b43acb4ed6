"""Line profiles of a volume."""

from __future__ import annotations

from itertools import product
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.imaging import Volume

Array = NDArray[np.float64]
Profile: TypeAlias = tuple[Array, Array]
"""Distances in m from a line's start, and values there."""
_MOST_SAMPLES = 4096


def profile(volume: Volume, start: ArrayLike, end: ArrayLike) -> Profile:
    """Return the values along a line, interpolated by cubic convolution, at most half the finest voxel apart.

    Parameters
    ----------
    volume
        The image.
    start, end
        Coordinates in metres in the order of its axes.

    Returns
    -------
    distances, values
        (N,) metres from ``start``, and the values there; what lies outside the outermost voxels' centres is left out.
    """
    first, last = np.asarray(start, np.float64), np.asarray(end, np.float64)
    length = float(np.linalg.norm(last - first))
    count = int(np.clip(np.ceil(2 * length / min(volume.spacing)) + 1, 2, _MOST_SAMPLES))
    share = np.linspace(0, 1, count)
    index = (first + share[:, None] * (last - first) - np.asarray(volume.origin)) / np.asarray(volume.spacing)
    sizes = np.asarray(volume.values.shape)
    inside = ((index >= -1e-6) & (index <= sizes - 1 + 1e-6)).all(axis=1)
    index = index[inside]
    cell = np.clip(np.floor(index).astype(np.int64), 0, np.maximum(sizes - 2, 0))
    weights = _weights(index - cell)
    values = np.zeros(len(index))
    for offsets in product(range(4), repeat=len(sizes)):
        weight = np.prod([weights[offset][:, axis] for axis, offset in enumerate(offsets)], axis=0)
        at = np.clip(cell + np.asarray(offsets) - 1, 0, sizes - 1)
        values += weight * volume.values[tuple(at.T)]
    return share[inside] * length, values


def _weights(t: Array) -> list[Array]:
    return [
        t * (-0.5 + t * (1 - 0.5 * t)),
        1 + t * t * (1.5 * t - 2.5),
        t * (0.5 + t * (2 - 1.5 * t)),
        t * t * (0.5 * t - 0.5),
    ]
