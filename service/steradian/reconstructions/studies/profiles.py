"""Line profiles of a volume, and the local orientation of elongated structures."""

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
_ELONGATED = 6.0
_REACH = 2.5


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


def direction_at(volume: Volume, place: ArrayLike, width: float) -> Array | None:
    """Return the direction (3,) of the elongated object at a position; ``None`` if the object is compact.

    It is that of the greatest spread of the voxels above half of the place's brightest, within 2.5 widths.
    """
    from scipy.ndimage import label

    centre, reach = np.asarray(place, np.float64), _REACH * width
    low, cut = [], []
    for name, step, at in zip(volume.names, volume.spacing, centre, strict=True):
        line = volume.coordinates(name)
        first, last = np.searchsorted(line, [at - reach - step / 2, at + reach + step / 2])
        low.append(float(line[min(first, len(line) - 1)]))
        cut.append(slice(int(first), int(last)))
    values = np.asarray(volume.values[tuple(cut)], np.float64)
    if values.size == 0:
        return None
    offsets = np.indices(values.shape).reshape(values.ndim, -1).T * volume.spacing + np.asarray(low) - centre
    distance = np.linalg.norm(offsets, axis=1)
    near = (distance <= reach).reshape(values.shape)
    core = values.ravel()[distance <= max(width / 2, 1.01 * max(volume.spacing))].max()
    labels, _ = label((values >= core / 2) & near, np.ones((3,) * values.ndim))
    bright = np.flatnonzero(labels.ravel())
    if len(bright) < 4:
        return None
    own = labels.ravel()[bright[distance[bright].argmin()]]
    chosen = labels.ravel() == own
    spreads, directions = np.linalg.eigh(np.cov(offsets[chosen].T))
    return directions[:, -1] if spreads[-1] > _ELONGATED * max(spreads[-2], 1e-30) else None
