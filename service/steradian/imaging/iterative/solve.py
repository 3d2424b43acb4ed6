"""Iterative reconstruction: the image whose A-lines fit the measured ones, among those a regulariser prefers.

By thresholding (:mod:`.thresholding`), or by accelerated proximal gradients (:mod:`.descent`).

The A-lines are thinned first to the band that holds signal (:mod:`.band`): the yarn of 45 µm balls at 8 ns to every
fourth sample, with voxels four times as deep. The result is interpolated to the depths asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.core.units import as_finite_float
from steradian.imaging import validation as checks
from steradian.imaging.compute import memory_limit as memory
from steradian.imaging.engines.array_namespace import is_gpu_array, to_numpy
from steradian.imaging.film_response import FilmResponse, InverseFilter
from steradian.imaging.geometry.depth_extent import Extent
from steradian.imaging.geometry.reconstruction import check_upper_frequency, depth_slice_range
from steradian.imaging.iterative.base import IterativeSolver, StopReason
from steradian.imaging.iterative.fista import Fista
from steradian.imaging.iterative.ista import IterativeSoftThresholding
from steradian.imaging.iterative_options import Iterative
from steradian.imaging.operators import ForwardOperator
from steradian.imaging.parameters import Device, Parameters
from steradian.imaging.plan import ReconstructionPlan
from steradian.imaging.signal.bandwidth import decimate, decimation_factor, signal_band, sinc_upsample
from steradian.imaging.validation import Sensors
from steradian.imaging.volume import RealArray, Volume, VoxelAxes


@dataclass(frozen=True, slots=True, eq=False)
class IterativeResult:
    """The image and how it was found.

    Parameters
    ----------
    volume
        The image.
    iterations
        How many were done.
    stopped
        "discrepancy", "change", "misfit" (a step took little of it away) or "iterations": what ended them.
    residuals
        ‖A f − g‖/‖g‖ at the start of each iteration; of thresholding also at its end.
    products
        Products with A and with Aᵀ, or direct reconstructions, in all: the unit of the method's cost.
    thinning
        Samples of the traces that one sample of the model stands for.
    memory_bytes
        Bound of what was allocated, the image included.
    device, notes
        What computed, "cpu" or a GPU's name, and why it is not what was asked for.
    """

    volume: Volume
    iterations: int
    stopped: StopReason
    residuals: tuple[float, ...]
    products: int
    thinning: int
    memory_bytes: int
    device: str = "cpu"
    notes: tuple[str, ...] = ()


def reconstruct_iteratively(
    traces: ArrayLike,
    positions: ArrayLike | Sensors,
    *,
    sampling_interval: float,
    sound_speed: float,
    aperture: float | Sequence[float] | None = None,
    modes: int | Sequence[int],
    options: Iterative | None = None,
    upsampling: int = 1,
    depth_range: tuple[float, float] | None = None,
    tolerance: float = 1e-4,
    time_zero: float = 0.0,
    lateral_padding: float | None = None,
    wrap: bool = False,
    scale: float = 1.0,
    response: FilmResponse | None = None,
    dtype: DTypeLike | None = None,
    memory_limit: int | None = None,
    threads: int | None = None,
    device: Device = "cpu",
    device_memory: int | None = None,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> IterativeResult:
    """Reconstruct by fitting; parameters not named here as in :func:`steradian.imaging._reconstruct`.

    Parameters
    ----------
    options
        Regulariser and stopping rule.
    depth_range
        First and last depth in metres. Sound from elsewhere is not in the model, so take in all there is.
    lateral_padding
        None: as much as keeps the periodic copies of the volume out of the record; refused where that is above 16.
    response
        The film's response, part of the model.
    memory_limit
        Refuse to start if more bytes than this are needed, image included; None: more than are available.

    Raises
    ------
    InvalidInput
        If a parameter is out of range.
    Cancelled
        If ``cancelled`` said so.
    """
    chosen = Parameters(
        method="iterative", iterative=options, sampling_interval=sampling_interval, sound_speed=sound_speed,
        aperture=aperture, modes=modes, upsampling=upsampling, depth_range=depth_range, tolerance=tolerance,
        time_zero=time_zero, lateral_padding=lateral_padding, wrap=wrap,
        correction=None if response is None else InverseFilter(response), dtype=dtype, memory_limit=memory_limit,
        threads=threads, device=device, device_memory=device_memory,
    )  # fmt: skip
    return solve(traces, positions, chosen, scale=scale, progress=progress, cancelled=cancelled)


def solve(
    traces: ArrayLike,
    positions: ArrayLike | Sensors,
    chosen: Parameters,
    *,
    scale: float = 1.0,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> IterativeResult:
    """Solve for given parameters as one value; raises as :func:`reconstruct_iteratively`."""
    options = chosen.iterative or Iterative()
    positions, _, aperture = checks.resolve_sensors(positions, None, chosen.aperture)
    positions = checks.check_positions(positions)
    kind, limit = chosen.precision, chosen.memory_limit
    data = to_numpy(traces)
    if data.ndim != 2 or not np.isfinite(data).all():
        raise InvalidInput(
            "traces", f"an array of shape {data.shape}", "finite numbers of shape (M, N_t), a row a sensor"
        )
    data, chosen = _since_pulse(data, chosen)
    scale = as_finite_float("scale", scale, "a finite factor")
    unit = _scale_unit(data, scale, kind)
    highest, noise = signal_band(data, chosen.sampling_interval)
    samples, interval = data.shape[1], chosen.sampling_interval
    factor = min(
        decimation_factor(check_upper_frequency(options.highest_frequency, samples, interval) or highest, interval),
        max(1, samples // 4),
    )
    step = chosen.sampling_interval * chosen.sound_speed
    extent = Extent.of(samples, interval, chosen.time_zero)
    first, last = depth_slice_range(chosen.depth_range, extent, samples + extent.ahead, samples + extent.ahead, step)
    nearest = first if chosen.depth_range is not None else _nearest_heard(positions, aperture, extent, step)
    thin_end = Extent(-(-samples // factor), extent.begins / factor).end
    coarse = (min(first, nearest) // factor, min(thin_end - 1, -(-last // factor)))
    measured = decimate(data, factor, kind, scale / unit)
    thin = replace(
        chosen,
        method="nedner",
        iterative=None,
        aperture=aperture,
        weights=None,
        upsampling=1,
        sampling_interval=chosen.sampling_interval * factor,
        depth_range=(coarse[0] * factor * step, coarse[1] * factor * step),
    )
    model = ForwardOperator.of(positions, measured.shape[1], thin)
    needed = _memory_bound(model, measured, options, factor, chosen.upsampling, last - first)
    memory.check_memory(needed, limit, (*(chosen.upsampling * n for n in model.geometry.modes), last - first))
    noise = min((noise if options.noise is None else options.noise) * (abs(scale) / unit), 2.0)  # no sample is larger
    expected = noise * np.sqrt(measured.size / factor)
    solver: Callable[..., IterativeSolver] = Fista
    resident = model.chosen.resident
    if options.regularisation == "thresholding":  # its inverse is not padded: what that loses, the next step finds
        inverse = ReconstructionPlan.from_parameters(positions, measured.shape[1], replace(thin, lateral_padding=None))
        solver, resident = partial(IterativeSoftThresholding, inverse), resident and inverse.chosen.resident
    shown = slice(first - coarse[0] * factor, last - coarse[0] * factor)

    def fitted(data: RealArray) -> tuple[IterativeSolver, RealArray]:
        solution = solver(model, data, options, float(expected), progress, cancelled)
        fine = sinc_upsample(solution.run(), (*(chosen.upsampling for _ in model.geometry.modes), factor), shown)
        if options.non_negative:
            np.maximum(fine, 0, out=fine)
        fine *= fine.dtype.type(unit)
        return solution, fine

    solution, fine = model.chosen.run_on_device(fitted, measured) if resident else fitted(measured)
    if is_gpu_array(fine) and not is_gpu_array(traces):
        fine = to_numpy(fine)
    volume = _volume(fine, model, chosen.upsampling, np.arange(first, last) * step, step)
    return IterativeResult(
        volume, solution.done, solution.stopped, tuple(solution.residuals), solution.products, factor, needed,
        model.chosen.device, tuple(model.chosen.notes),
    )  # fmt: skip


def _since_pulse(data: RealArray, chosen: Parameters) -> tuple[RealArray, Parameters]:
    """Exclude samples before the laser pulse, in which the model would predict sound."""
    extent = Extent.of(data.shape[1], chosen.sampling_interval, chosen.time_zero)
    before = max(0, ceil(-extent.begins))
    if not before:
        return data, chosen
    return data[:, before:], replace(chosen, time_zero=chosen.time_zero + before * chosen.sampling_interval)


def _nearest_heard(
    positions: NDArray[np.float64], aperture: float | Sequence[float] | None, extent: Extent, step: float
) -> int:
    """Return the slice nearest to the film from which a late record can hold sound, to sensors far to the side.

    The model takes it in, though the image begins deeper: it would explain that sound by something deeper else.
    """
    sides = np.array(checks.apertures(aperture, positions.shape[1]))
    farthest = float(np.linalg.norm(np.abs(positions).max(axis=0) + sides / 2))
    return int(np.sqrt(max(0.0, extent.ahead**2 - (farthest / step) ** 2)))


def _scale_unit(data: RealArray, scale: float, dtype: str) -> float:
    """Power of two close to the largest sample, by which iterations are scaled, so that squares do not overflow."""
    largest = float(np.abs(data).max(initial=0.0)) * abs(scale)
    if not largest < 2.0 ** checks.MAX_EXPONENT[dtype]:
        raise InvalidInput("traces", "beyond the range of the working precision", "finite numbers")
    return float(2.0 ** np.floor(np.log2(largest))) if largest > 0 else 1.0


def _memory_bound(
    model: ForwardOperator, measured: RealArray, options: Iterative, factor: int, upsampling: int, depths: int
) -> int:
    """Upper bound of a run's allocations: modes, scratch, traces and images of the iterations, or the fine image."""
    item = measured.dtype.itemsize
    image = int(np.prod(model.volume_shape)) * item
    dual = 3 * image if options.regularisation == "total-variation" else 0
    kept = int(2.5 * image) if options.regularisation == "thresholding" else 4 * image
    lateral = int(np.prod(model.volume_shape[:-1])) * int(upsampling ** (len(model.volume_shape) - 1))
    fine = int((1.4 * depths + (depths + 2 * factor) / factor) * lateral * item)
    # a tenth for tables and what is worked on in pieces
    iterations = model.memory_bytes + kept + 4 * int(measured.nbytes)
    return int(1.1 * (dual + max(iterations, kept + fine)))


def _volume(values: RealArray, model: ForwardOperator, upsampling: int, depths: Any, step: float) -> Volume:
    g = replace(model.geometry, upsampling=upsampling)
    axes = g.axes()
    return Volume(values, VoxelAxes(axes.x, axes.y, depths), (*g.spacing[:-1], step), g.sound_speed)
