"""The function :func:`uncertainty`: standard error of a direct image, voxel by voxel.

A direct image is a sum over the sensors. With opposite signs of the two A-lines of each pair of neighbours, and the
pairs' signs drawn at random, the object, on which neighbours agree, cancels, and what differs between them remains:
noise, and the streaks of a finite number of sensors. The mean square of such images estimates the image's variance
(successive difference replication, Fay and Train 1995, with random instead of orthogonal signs). Neighbours are those
along a curve that fills the plane (:func:`.half_images.morton_order`).

The mean over a cube of 3 voxels a side makes the estimate steadier: variances vary little over such a distance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging import validation as checks
from steradian.imaging._reconstruct import direct_plan
from steradian.imaging.acquisition import Acquisition
from steradian.imaging.compute import memory_limit as memory
from steradian.imaging.engines.array_namespace import to_numpy
from steradian.imaging.half_images import MIN_SENSORS, morton_order
from steradian.imaging.options import Compute, DirectMethod, ImageGrid, Nufft, require_direct
from steradian.imaging.volume import Volume

MAX_REPLICATES = 10_000
CUBE = 3
"""Side in voxels of the neighbourhood whose variances are averaged."""


def uncertainty(
    acquisition: Acquisition,
    grid: ImageGrid,
    method: DirectMethod = Nufft(),
    *,
    replicates: int = 8,
    compute: Compute = Compute(),
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Volume:
    """Return the standard error of each voxel of the image that :func:`reconstruct` makes by a direct method.

    It covers the noise of the A-lines and the streaks of a finite number of sensors: image ± standard error holds about
    68 % of the voxels of the noise-free image from very many sensors over the same area. It does not cover what all
    sensors have in common: the limited view, the band, a wrong sound speed, timing or film response. The iterative
    method has no such estimate: it is not linear, and its error is not that of its sensors' sum.

    Parameters
    ----------
    acquisition
        A-lines (M, N_t) with at least 16 sensors; each should have noise independent of the others'.
    grid, method, compute
        As for the image.
    replicates
        Number of images with random signs, each of the cost of the image, 2 to 10,000. A voxel's result has a relative
        standard error of at most about 1/√(2·replicates).
    progress, cancelled
        See :mod:`steradian.core.progress`.

    Returns
    -------
    Volume
        Standard errors ≥ 0 on the voxels of the image, in its unit.

    Raises
    ------
    InvalidInput
        If a parameter is out of range, the method is not a direct one, there are fewer than 16 sensors, or the images
        do not fit into the memory.
    Cancelled
        If ``cancelled`` returned true.

    Examples
    --------
    >>> volume = steradian.reconstruct(acquisition, grid)  # doctest: +SKIP
    >>> error = steradian.uncertainty(acquisition, grid)  # doctest: +SKIP
    >>> is_seen = volume.values > 3 * error.values  # doctest: +SKIP
    """
    require_direct(method, "; the iterative method is not linear in its A-lines")
    if replicates != int(replicates) or not 2 <= replicates <= MAX_REPLICATES:
        raise InvalidInput("replicates", replicates, f"a whole number from 2 to {MAX_REPLICATES}")
    sensors = checks.resolve_sensors(acquisition.sensors, acquisition.weights, acquisition.aperture)[0]
    positions = np.asarray(sensors, np.float64)
    if len(positions) < MIN_SENSORS:
        raise InvalidInput("sensors", f"{len(positions)} sensors", f"{MIN_SENSORS} or more")
    plan = direct_plan(acquisition, grid, method, compute)
    memory.check_memory(plan.memory_bytes + 2 * plan.output_bytes, compute.memory_limit, plan.geometry.shape)
    traces, random = to_numpy(acquisition.traces), np.random.default_rng(0)
    order = sensor_order(positions)
    variance = np.zeros(plan.geometry.shape, plan.dtype)
    for number in range(int(replicates)):
        if progress is not None:
            progress("replicates", number, int(replicates))
        signs = paired_signs(order, random)[:, None]
        image = plan.run(traces * signs, scale=acquisition.scale, cancelled=cancelled)
        assert isinstance(image, Volume)  # noqa: S101 - of one set of traces
        variance += np.square(image.values, out=image.values)
    if progress is not None:
        progress("replicates", int(replicates), int(replicates))
    volume = plan.as_volume(_root_mean(variance, int(replicates)))
    assert volume.info is not None  # noqa: S101
    notes = (*volume.info.notes, f"standard errors, of {int(replicates)} images with random signs of the A-lines")
    return replace(volume, info=replace(volume.info, notes=notes))


def sensor_order(positions: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the order of sensors (M,), (M, 1) or (M, 2) in which near numbers are near places."""
    if positions.ndim == 1 or positions.shape[1] == 1:
        return np.argsort(positions.reshape(len(positions)), kind="stable").astype(np.int64)
    return morton_order(positions)


def paired_signs(order: NDArray[np.int64], random: np.random.Generator) -> NDArray[np.float32]:
    """Return a sign for each sensor (M,): opposite ones for each pair along the order, at random from pair to pair."""
    pairs = random.choice(np.array([-1, 1], np.float32), (len(order) + 1) // 2)
    signs = np.empty(len(order), np.float32)
    signs[order[::2]] = pairs
    signs[order[1::2]] = -pairs[: len(order) // 2]
    return signs


def _root_mean(sums: NDArray[np.floating], count: int) -> NDArray[np.floating]:
    """Return the root of the mean of ``count`` squares, averaged over neighbouring voxels."""
    from scipy.ndimage import uniform_filter

    variance: NDArray[np.floating] = uniform_filter(sums, CUBE, mode="nearest")
    variance /= count
    np.maximum(variance, 0, out=variance)  # running sums round
    np.sqrt(variance, out=variance)
    return variance
