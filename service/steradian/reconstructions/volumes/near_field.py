"""Near field: shallow depths of an image that are dominated by artefacts of the sensors.

A sensor's own noise comes from everywhere at one distance from it, and is the stronger in the image the smaller that
distance is: right below sparse sensors it stands as bright dots at their positions.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.imaging import Volume

NOISE_RATIO = 1.1
"""The near field ends where the image is hardly brighter below the sensors than elsewhere (root mean square)."""
RISE_RATIO = 1.5
"""Or where the image's root mean square has grown so many times: noise alone keeps it, an object begins there."""
MAX_DEPTH = 2.0
"""It ends at so many times the sensors' coarsest spacing at the latest: farther off they see the same places."""
MIN_CONTRAST = 0.25
"""It is left alone where its brightest value stays below this share of the rest's."""


def near_field_depth(volume: Volume, positions: NDArray[np.float64]) -> float:
    """Return the depth in metres at which the near field ends: artefacts of the sensors dominate above it.

    Parameters
    ----------
    volume
        The image.
    positions
        (M, 2), or (M,) or (M, 1) for a line: sensors in metres.

    Returns
    -------
    float
        Depth in metres from which the image is worth looking at; 0 where the sensors do not stand out, as those of
        a grid with a sensor above each voxel never do.
    """
    from scipy.spatial import KDTree

    places = np.asarray(positions, np.float64).reshape(len(positions), -1)
    if len(places) < 2:
        return 0.0
    coarsest = float(np.asarray(KDTree(places).query(places, k=2)[0])[:, 1].max())
    z = volume.axes.z
    end = min(int(np.searchsorted(z, MAX_DEPTH * coarsest)), len(z) - 1)
    if not end:
        return 0.0
    near = volume.values[..., :end]
    below = near[tuple(_voxels(volume, places))]
    mean = np.sqrt(np.mean(np.square(near, dtype=np.float64), axis=tuple(range(near.ndim - 1))))
    ratio = np.sqrt(np.mean(np.square(below, dtype=np.float64), axis=0)) / np.maximum(mean, 1e-300)
    over = np.flatnonzero((ratio <= NOISE_RATIO) | (mean > RISE_RATIO * mean[:3].max()))
    first = int(over[0]) if len(over) else end
    if not first or float(near[..., :first].max()) < MIN_CONTRAST * float(volume.values[..., first:].max()):
        return 0.0
    return float(z[first])


def crop_depth(volume: Volume, depth: float) -> Volume:
    """Return a view of an image without the depths above a limit in metres; at least the last slice remains."""
    first = min(int(np.searchsorted(volume.axes.z, depth - 1e-9)), len(volume.axes.z) - 1)
    if not first:
        return volume
    axes = type(volume.axes)(volume.axes.x, volume.axes.y, volume.axes.z[first:])
    return replace(volume, values=volume.values[..., first:], axes=axes)


def _voxels(volume: Volume, places: NDArray[np.float64]) -> list[NDArray[Any]]:
    """Return the voxel indices of the columns below the sensors, per axis, clipped to the image."""
    lateral = zip(volume.names[:-1], volume.spacing[:-1], places.T, strict=True)
    found = []
    for name, step, at in lateral:
        line = volume.coordinates(name)
        found.append(np.clip(np.rint((at - line[0]) / step).astype(np.int64), 0, len(line) - 1))
    return found
