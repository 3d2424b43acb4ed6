"""Images of two interleaved halves of the sensors, for cross-validation.

An object is in both images. Noise, the dots below single sensors and the streaks of undersampling are of one half
each, so the product of both images has no part of them on the mean.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck
from steradian.imaging._reconstruct import reconstruct
from steradian.imaging.acquisition import Acquisition
from steradian.imaging.geometry.polygons import Outline
from steradian.imaging.geometry.sensor_sensitivity import check_sensitivity
from steradian.imaging.geometry.voronoi import voronoi_cell_areas
from steradian.imaging.options import Compute, DirectMethod, ImageGrid, Nufft
from steradian.imaging.volume import Volume

ORDER_BITS = 16
"""Bits of each coordinate in the Morton order."""
MIN_SENSORS = 16


def half_images(
    acquisition: Acquisition,
    outline: Outline,
    grid: ImageGrid,
    method: DirectMethod | None = None,
    *,
    compute: Compute | None = None,
    cancelled: CancelCheck | None = None,
) -> tuple[Volume, Volume]:
    """Reconstruct every other sensor along a curve that fills the plane, and the others.

    Parameters
    ----------
    acquisition
        A-lines with sensors (M, 2) in a plane, at least 16; each half has the areas of its own cells as weights.
    outline
        Region that the sensors cover.
    grid, method, compute
        As of :func:`steradian.imaging.reconstruct`; a direct method, ``None`` for NEDNER.
    cancelled
        Asked between pieces of work.

    Returns
    -------
    tuple of Volume
        Both images.

    Raises
    ------
    InvalidInput
        When there are fewer than 16 sensors, or they are on a line.
    Cancelled
        When ``cancelled`` returned ``True``.
    """
    positions = np.asarray(acquisition.sensors, np.float64)
    if positions.ndim != 2 or positions.shape[1] != 2:
        raise InvalidInput("sensors", "on a line", "in a plane")
    if len(positions) < MIN_SENSORS:
        raise InvalidInput("sensors", f"{len(positions)} sensors", f"{MIN_SENSORS} or more")
    order, traces = morton_order(positions), np.asarray(acquisition.traces)
    if len(traces) != len(positions):
        raise InvalidInput("traces", f"an array of shape {traces.shape}", f"{len(positions)} rows, one for each sensor")
    if acquisition.sensitivity is not None:
        check_sensitivity(acquisition.sensitivity, len(positions))
    images = []
    for half in (order[::2], order[1::2]):
        weights, sensitivity = voronoi_cell_areas(positions[half], outline), acquisition.sensitivity
        if sensitivity is not None:
            sensitivity = np.asarray(sensitivity)[half]
        part = replace(
            acquisition, traces=traces[half], sensors=positions[half], weights=weights, sensitivity=sensitivity
        )
        images.append(reconstruct(part, grid, method or Nufft(), compute=compute or Compute(), cancelled=cancelled))
    return images[0], images[1]


def morton_order(places: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the order of places (N, 2) along a Morton (Z) curve, in which near numbers are near places."""
    low = places.min(axis=0)
    cells = ((places - low) / (np.ptp(places, axis=0).max() or 1.0) * (2**ORDER_BITS - 1)).astype(np.uint64)
    code = np.zeros(len(places), np.uint64)
    for bit in range(ORDER_BITS):
        for axis in (0, 1):
            code |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(2 * bit + axis)
    return np.argsort(code, kind="stable").astype(np.int64)
