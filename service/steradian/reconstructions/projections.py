"""Projections: the brightest value along each axis of a volume, all three in one pass."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from steradian.imaging import Volume

Axis: TypeAlias = Literal["x", "y", "z"]
Projections: TypeAlias = dict[Axis, NDArray[np.floating[Any]]]


def project(volume: Volume) -> Projections:
    """Return the maximum-intensity projections along every axis.

    A plane of constant x is looked at three times while it is in the cache: a third of the time of three passes.

    Returns
    -------
    dict
        ``x`` [y, z], ``y`` [x, z] and ``z`` [x, y]; of an image [x, z] from a line of sensors, ``y``: the image itself.
    """
    values = volume.values
    if volume.dimensions == 2:
        return {"y": values}
    along_y = np.empty((values.shape[0], values.shape[2]), values.dtype)
    along_z = np.empty(values.shape[:2], values.dtype)
    along_x = values[0].copy()
    for i, plane in enumerate(values):
        np.maximum(along_x, plane, out=along_x)
        plane.max(axis=0, out=along_y[i])
        plane.max(axis=1, out=along_z[i])
    return {"x": along_x, "y": along_y, "z": along_z}
