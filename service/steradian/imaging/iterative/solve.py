"""Iterative reconstruction: regularised least-squares fit of the image to the A-lines.

By thresholding (:mod:`.ista`), or by accelerated proximal gradients (:mod:`.fista`).

The A-lines are thinned first to the band that holds signal (:mod:`.band`): the yarn of 45 µm balls at 8 ns to every
fourth sample, with voxels four times as deep. The result is interpolated to the depths asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import ceil, floor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging import validation as checks
from steradian.imaging.acquisition import Acquisition, AcquisitionGeometry
from steradian.imaging.compute import memory_limit as memory
from steradian.imaging.engines.array_namespace import is_gpu_array, like, to_numpy
from steradian.imaging.geometry.depth_extent import Extent
from steradian.imaging.geometry.layers import layered_slices
from steradian.imaging.geometry.reconstruction import check_upper_frequency, depth_slice_range
from steradian.imaging.iterative.base import IterativeSolver
from steradian.imaging.iterative.fista import Fista
from steradian.imaging.iterative.ista import IterativeThresholding
from steradian.imaging.iterative_options import Iterative, IterativeOptions
from steradian.imaging.operators import ForwardOperator
from steradian.imaging.options import Compute, ImageGrid, Nufft
from steradian.imaging.plan import ReconstructionPlan, hidden_angles
from steradian.imaging.signal.bandwidth import decimate, decimation_factor, signal_band, sinc_upsample
from steradian.imaging.volume import RealArray, ReconstructionInfo, Volume, VoxelAxes

ROUGH_SHARE = 0.55
"""Share of the lateral padding beyond the image that the model of thresholding's steps has."""
MIN_ROUGH_PADDING = 1.3
"""Least padding of the model for which the steps have a model of their own."""


def solve(
    acquisition: Acquisition,
    grid: ImageGrid,
    options: Iterative = Iterative(),
    *,
    start: Volume | None = None,
    compute: Compute = Compute(),
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Volume:
    """Reconstruct by fitting the forward model to the A-lines.

    Parameters
    ----------
    acquisition
        A-lines (M, N_t) with sensors and timing; weights play no part.
    grid
        Voxels, without ``depth_step`` and ``time_padding``. Sound from outside ``depth`` is not in the model, so the
        range must contain all sources. ``lateral_padding`` None: as much as keeps the periodic copies of the volume
        out of the record, refused if that is above 16.
    options
        Regulariser, stopping rule, tolerance and film response.
    start
        Image on the same voxels at which the iteration begins, such as the frame before; it is scaled to the A-lines.
        None: zero.
    compute
        Execution options.
    progress, cancelled
        See :mod:`steradian.core.progress`.

    Returns
    -------
    Volume
        Indexed [x, y, z] ([x, z] in 2-D); its ``info`` has iterations, residuals and the stop reason.

    Raises
    ------
    InvalidInput
        If a parameter is out of range.
    Cancelled
        If ``cancelled`` returned true.
    """
    grid.require_defaults("the method iterative", "depth_step", "time_padding")
    geometry = acquisition.geometry
    positions, _, aperture = checks.resolve_sensors(geometry.sensors, None, geometry.aperture)
    positions = checks.check_positions(positions)
    kind = compute.precision(options.tolerance)
    data = to_numpy(acquisition.traces)
    if not np.isfinite(data).all():
        raise InvalidInput(
            "traces", f"an array of shape {data.shape}", "finite numbers of shape (M, N_t), a row a sensor"
        )
    data, geometry = _since_pulse(data, geometry)
    unit = _scale_unit(data, acquisition.scale, kind)
    highest, noise = signal_band(data, geometry.dt)
    samples, interval = geometry.samples, geometry.dt
    limit = check_upper_frequency(options.highest_frequency, samples, interval, "highest_frequency") or highest
    factor = min(decimation_factor(limit, interval), max(1, samples // 4))
    step = interval * geometry.sound_speed
    extent = Extent.of(samples, interval, geometry.t0)
    first, last = _slices(geometry, grid, extent)
    nearest = first if grid.depth is not None else _nearest_heard(positions, aperture, extent, step)
    thin_end = Extent(-(-samples // factor), extent.begins / factor).end
    if len(geometry.medium.layers) > 1:  # where sound is faster than in the slowest layer, more slices are heard
        thin_end = floor(geometry.medium.depth_at(thin_end * factor * interval) / (factor * step))
    coarse = (min(first, nearest) // factor, min(thin_end - 1, -(-last // factor)))
    measured = decimate(data, factor, kind, acquisition.scale / unit)
    thin = replace(
        geometry, sensors=positions, samples=measured.shape[1], dt=interval * factor, aperture=aperture, weights=None
    )
    voxels = replace(grid, upsampling=1, depth=(coarse[0] * factor * step, coarse[1] * factor * step))
    response = options.correction and options.correction.response
    model = ForwardOperator(thin, voxels, response=response, tolerance=options.tolerance, compute=compute)
    needed = _memory_bound(model, measured, options, factor, grid.upsampling, last - first)
    shape = (*(grid.upsampling * n for n in model.geometry.modes), last - first)
    memory.check_memory(needed, compute.memory_limit, shape)
    noise = noise if options.noise is None else options.noise
    noise = min(noise * (abs(acquisition.scale) / unit), 2.0)  # no sample is larger
    expected = noise * np.sqrt(measured.size / factor)
    solver: Callable[..., IterativeSolver] = Fista
    resident = model.chosen.resident
    if options.regularisation == "thresholding":  # its inverse is not padded: what that loses, the next step finds
        direct = Nufft(tolerance=options.tolerance, correction=options.correction)
        inverse = ReconstructionPlan(thin, replace(voxels, lateral_padding=None), direct, compute=compute)
        for layer in inverse.layers:
            if layer.compensation is not None:
                deviation = float(expected) / float(np.sqrt(measured.size))
                layer.compensation.hold(measured, noise=deviation, highest=float(limit))
        rough = _rough_model(model, thin, voxels, options, compute)
        solver, resident = partial(IterativeThresholding, inverse, rough=rough), resident and inverse.chosen.resident
    shown = slice(first - coarse[0] * factor, last - coarse[0] * factor)
    whole, unresolved = slice(0, model.volume_shape[-1]), list[str]()
    support = whole if grid.depth is not None else _support(positions, model, coarse[0], thin_end, unresolved)

    begun = None
    if start is not None:
        begun = _decimated(start.values, shape, model.volume_shape, (grid.upsampling, factor, coarse[0], first))

    def fitted(data: RealArray) -> tuple[IterativeSolver, RealArray]:
        solution = solver(model, data, options, float(expected), progress, cancelled, support)
        from_image = None if begun is None else like(begun.astype(kind), data)
        fine = sinc_upsample(
            solution.run(from_image),
            (*(grid.upsampling for _ in model.geometry.modes), factor),
            shown,
            threads=model.threads,
        )
        if options.non_negative:
            np.maximum(fine, 0, out=fine)
        fine *= fine.dtype.type(unit)
        return solution, fine

    solution, fine = model.chosen.run_on_device(fitted, measured) if resident else fitted(measured)
    if is_gpu_array(fine) and not is_gpu_array(acquisition.traces):
        fine = to_numpy(fine)
    info = ReconstructionInfo(
        options.name,
        model.chosen.device,
        (*model.chosen.notes, *hidden_angles(geometry.medium), *unresolved),
        float(limit),
        iterations=solution.done,
        stop_reason=solution.stopped,
        residuals=tuple(solution.residuals),
        products=solution.products,
        decimation=factor,
        memory_bytes=needed,
    )
    return _volume(fine, model, grid.upsampling, np.arange(first, last) * step, step, info)


def _rough_model(
    model: ForwardOperator, thin: AcquisitionGeometry, voxels: ImageGrid, options: Iterative, compute: Compute
) -> ForwardOperator | None:
    """Return the model with a part of the lateral padding only; None where that saves nothing, or less was asked for.

    The volume's copies are then heard at the end of the record, by the sensors at the rim: that is less than noise.
    """
    g = model.geometry
    most = max(period / side for period, side in zip(g.period, g.aperture, strict=True))
    if voxels.lateral_padding is not None or len(thin.medium.layers) > 1 or most < MIN_ROUGH_PADDING:
        return None
    less = replace(voxels, lateral_padding=1 + ROUGH_SHARE * (most - 1))
    response = options.correction and options.correction.response
    return ForwardOperator(thin, less, response=response, tolerance=options.tolerance, compute=compute)


def _decimated(
    values: Any, shape: tuple[int, ...], coarse_shape: tuple[int, ...], sampling: tuple[int, int, int, int]
) -> NDArray[Any]:
    """Return an image of the shape of results at the model's voxels, zero at depths that it does not have.

    ``sampling``: lateral upsampling, slices of the result to one of the model, the model's and the image's first slice.
    """
    if np.shape(values) != shape:
        raise InvalidInput("start", f"an image of shape {np.shape(values)}", f"shape {shape}, that of the result")
    upsampling, factor, coarse_first, first = sampling
    image = to_numpy(values)
    slices = factor * (coarse_first + np.arange(coarse_shape[-1])) - first
    inside = np.flatnonzero((slices >= 0) & (slices < shape[-1]))
    begun = np.zeros(coarse_shape, image.dtype)
    if len(inside):
        of_model, of_image = slice(inside[0], inside[-1] + 1), slice(slices[inside[0]], slices[inside[-1]] + 1, factor)
        lateral = (slice(None, None, upsampling),) * (len(shape) - 1)
        begun[..., of_model] = image[(*lateral, of_image)]
    return begun


def _slices(geometry: AcquisitionGeometry, grid: ImageGrid, extent: Extent) -> tuple[int, int]:
    """Return first and end index of the image's depth slices, a sample of the slowest layer apart."""
    step, samples = geometry.dt * geometry.sound_speed, geometry.samples
    if len(geometry.medium.layers) == 1:
        return depth_slice_range(grid.depth, extent, samples + extent.ahead, samples + extent.ahead, step)
    latest = extent.end * geometry.dt
    return layered_slices(geometry.medium, extent, grid.depth, step=step, interval=geometry.dt, latest=latest)


def _since_pulse(data: RealArray, geometry: AcquisitionGeometry) -> tuple[RealArray, AcquisitionGeometry]:
    """Exclude samples before the laser pulse, at which the model would predict sound."""
    extent = Extent.of(geometry.samples, geometry.dt, geometry.t0)
    before = max(0, ceil(-extent.begins))
    if not before:
        return data, geometry
    later = replace(geometry, samples=geometry.samples - before, t0=geometry.t0 + before * geometry.dt)
    return data[:, before:], later


def _nearest_heard(
    positions: NDArray[np.float64], aperture: float | Sequence[float] | None, extent: Extent, step: float
) -> int:
    """Return the shallowest slice whose sound a late record can contain, at sensors far to the side.

    The model takes it in, though the image begins deeper: it would explain that sound by something deeper else.
    """
    sides = np.array(checks.apertures(aperture, positions.shape[1]))
    farthest = float(np.linalg.norm(np.abs(positions).max(axis=0) + sides / 2))
    return int(np.sqrt(max(0.0, extent.ahead**2 - (farthest / step) ** 2)))


def _support(positions: NDArray[np.float64], model: ForwardOperator, first: int, end: int, notes: list[str]) -> slice:
    """Return the depth slices of the model that can hold sources, and add a note on those that cannot.

    Closer to the film than half the mean spacing of the sensors, a source dominates the record of the sensor above it,
    and just before the end of the record it is heard by that one alone: there each sensor's noise would be explained.
    """
    area = float(np.prod(np.ptp(positions, axis=0)))
    margin = 0.5 * (area / len(positions)) ** (1 / positions.shape[1])
    slices = ceil(margin / model.geometry.spacing[-1])
    low, high = max(0, slices - first), min(model.volume_shape[-1], end - slices - first)
    if not margin or low >= high:
        return slice(0, model.volume_shape[-1])
    places = "the film and of the depth" if low > 0 else "the depth"  # a late record's image begins deeper
    notes.append(
        f"no sources within {1e3 * margin:.2f} mm (half the sensors' mean spacing) of {places} at which the record "
        "ends; a depth range that reaches there allows them"
    )
    return slice(low, high)


def _scale_unit(data: RealArray, scale: float, dtype: str) -> float:
    """Return a power of two close to the largest sample, as scale that prevents overflow of squares."""
    largest = float(np.abs(data).max(initial=0.0)) * abs(scale)
    if not largest < 2.0 ** checks.MAX_EXPONENT[dtype]:
        raise InvalidInput("traces", "beyond the range of the working precision", "finite numbers")
    return float(2.0 ** np.floor(np.log2(largest))) if largest > 0 else 1.0


def _memory_bound(
    model: ForwardOperator, measured: RealArray, options: IterativeOptions, factor: int, upsampling: int, depths: int
) -> int:
    """Return an upper bound of a run's allocations: modes, scratch, traces and images, or the upsampled image."""
    item = measured.dtype.itemsize
    image = int(np.prod(model.volume_shape)) * item
    dual = 3 * image if options.regularisation == "total-variation" else 0
    kept = int((3.5 if options.regularisation == "thresholding" else 4) * image)
    lateral = int(np.prod(model.volume_shape[:-1])) * int(upsampling ** (len(model.volume_shape) - 1))
    fine = int((1.4 * depths + (depths + 2 * factor) / factor) * lateral * item)
    # a tenth for tables and what is worked on in pieces
    iterations = model.memory_bytes + kept + 6 * int(measured.nbytes)
    return int(1.1 * (dual + max(iterations, kept + fine)))


def _volume(
    values: RealArray, model: ForwardOperator, upsampling: int, depths: Any, step: float, info: ReconstructionInfo
) -> Volume:
    g = replace(model.geometry, upsampling=upsampling)
    axes = g.axes()
    return Volume(values, VoxelAxes(axes.x, axes.y, depths), (*g.spacing[:-1], step), g.sound_speed, info)
