"""Local orientation of elongated structures of a volume."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.imaging import Volume

Array = NDArray[np.float64]
_ELONGATED = 6.0
_REACH = 2.5


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
