"""Iterative reconstruction: the image whose A-lines fit the measured ones, among those a regulariser prefers.

By thresholding (:mod:`.thresholding`), or as here:

    minimise over f (≥ 0):  ½‖A f − g‖² + λ·R(f),   A the :class:`~steradian.imaging.operators.ForwardOperator`

by accelerated proximal gradients (FISTA with restarts). From few sensors the direct formula leaves the streaks of each
one all over the volume; what is non-negative, and flat or sparse, cannot hold them.

The A-lines are thinned first to the band that holds signal (:mod:`.band`): the yarn of 45 µm balls at 8 ns to every
fourth sample, with voxels four times as deep. The result is interpolated to the depths asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from steradian.errors import Cancelled, InvalidInput
from steradian.imaging import checks, memory
from steradian.imaging.band import refined, signal_band, thinned, thinning
from steradian.imaging.checks import Sensors
from steradian.imaging.iterative_options import Iterative
from steradian.imaging.operators import ForwardOperator
from steradian.imaging.plan import ReconstructionPlan
from steradian.imaging.regularisers import proximal
from steradian.imaging.response import Correction, FilmResponse
from steradian.imaging.thresholding import Stopped, Thresholding
from steradian.imaging.volume import Axes, RealArray, Volume
from steradian.progress import IsCancelled, Progress
from steradian.ranges import SAMPLING_INTERVAL, SOUND_SPEED, real

_POWER_STEPS = 6
_SAFETY = 1.1  # of the largest singular value found by so many power steps


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
    """

    volume: Volume
    iterations: int
    stopped: Stopped
    residuals: tuple[float, ...]
    products: int
    thinning: int
    memory_bytes: int


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
    progress: Progress | None = None,
    cancelled: IsCancelled | None = None,
) -> IterativeResult:
    """Reconstruct by fitting; parameters not named here as in :func:`steradian.imaging.reconstruct`.

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
    chosen = options or Iterative()
    if not isinstance(chosen, Iterative):
        raise InvalidInput("iterative", type(chosen).__name__, "steradian.imaging.Iterative(…), or None")
    positions, _, aperture = checks.of_mask(positions, None, aperture)
    positions = checks.places(positions)
    aperture = checks.apertures(aperture, positions.shape[1])
    sampling_interval = SAMPLING_INTERVAL.check("sampling_interval", sampling_interval)
    sound_speed = SOUND_SPEED.check("sound_speed", sound_speed)
    time_zero = checks.start_time(time_zero)
    upsampling = checks.whole("upsampling", upsampling, 1, 16)
    tolerance = checks.within("tolerance", tolerance, 1e-12, 0.1, "a relative error")
    kind = checks.working_precision(dtype, tolerance)
    data = np.asarray(traces)
    if data.ndim != 2 or not np.isfinite(data).all():
        raise InvalidInput(
            "traces", f"an array of shape {data.shape}", "finite numbers of shape (M, N_t), a row a sensor"
        )
    highest, noise = signal_band(data, sampling_interval)
    factor = thinning(chosen.highest_frequency or highest, sampling_interval)
    step = sampling_interval * sound_speed
    first, last, coarse = _slices(depth_range, data.shape[1], factor, step)
    measured = thinned(data, factor, kind)
    measured *= measured.dtype.type(real("scale", scale, "a finite factor"))
    common: dict[str, Any] = {
        "samples": measured.shape[1],
        "sampling_interval": sampling_interval * factor,
        "sound_speed": sound_speed,
        "aperture": aperture,
        "modes": modes,
        "depth_range": (coarse[0] * factor * step, coarse[1] * factor * step),
        "time_zero": time_zero,
        "tolerance": tolerance,
        "wrap": wrap,
        "dtype": kind,
        "memory_limit": memory_limit,
        "threads": threads,
    }
    model = ForwardOperator(positions, lateral_padding=lateral_padding, response=response, **common)
    needed = _bytes(model, measured, chosen, factor, upsampling, last - first)
    memory.require(needed, memory_limit, (*(upsampling * n for n in model.geometry.modes), last - first))
    expected = (noise if chosen.noise is None else chosen.noise) * abs(scale) * np.sqrt(measured.size / factor)
    solver: Callable[..., _Descent | Thresholding] = _Descent
    if chosen.regularisation == "thresholding":  # its inverse is not padded: what that loses, the next step finds
        correction = None if response is None else Correction(response)
        solver = partial(Thresholding, ReconstructionPlan(positions, correction=correction, **common))
    solution = solver(model, measured, chosen, float(expected), progress, cancelled)
    shown = slice(first - coarse[0] * factor, last - coarse[0] * factor)
    fine = refined(solution.run(), (*(upsampling for _ in model.geometry.modes), factor), shown)
    if chosen.non_negative:
        np.maximum(fine, 0, out=fine)
    volume = _volume(fine, model, upsampling, np.arange(first, last) * step, step)
    return IterativeResult(
        volume, solution.done, solution.stopped, tuple(solution.residuals), solution.products, factor, needed
    )


class _Descent:
    """FISTA (Beck and Teboulle 2009) with the restart of O'Donoghue and Candès (2015)."""

    def __init__(
        self,
        model: ForwardOperator,
        measured: RealArray,
        options: Iterative,
        noise: float,
        progress: Progress | None,
        cancelled: IsCancelled | None,
    ) -> None:
        self._model, self._data, self._options, self._noise = model, measured, options, noise
        self._progress, self._cancelled = progress, cancelled
        self.residuals: list[float] = []
        self.products = self.done = 0
        self.stopped: Stopped = "iterations"
        g = model.geometry
        self._proximal = proximal(
            options.regularisation,
            non_negative=options.non_negative,
            shape=model.volume_shape,
            spacing=g.spacing,
            threads=model.threads,
        )

    def run(self) -> RealArray:
        back = self._adjoint(self._data)
        norm = float(np.linalg.norm(self._data)) or 1.0
        curvature = self._curvature(back)
        weight = self._options.weight()
        weight *= curvature if self._options.regularisation == "tikhonov" else float(np.abs(back).max())
        kind = back.dtype.type
        image, point, new = np.zeros_like(back), np.zeros_like(back), np.empty_like(back)
        momentum = 1.0
        for iteration in range(self._options.iterations):
            self._look(iteration)
            if iteration:
                residual = self._forward(point)
                residual -= self._data
                back = self._adjoint(residual)
            else:
                residual, back = -self._data, -back
            size = float(np.linalg.norm(residual))
            self.residuals.append(size / norm)
            limit = self._options.discrepancy
            if limit is not None and iteration and size <= limit * self._noise:
                self.stopped = "discrepancy"
                break
            back *= kind(-1 / curvature)
            back += point
            self._proximal(back, new, weight / curvature)
            self.done = iteration + 1
            np.subtract(point, new, out=point)
            np.subtract(new, image, out=image)  # the step
            change, total = float(np.linalg.norm(image)), float(np.linalg.norm(new))
            following = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
            ahead = (momentum - 1) / following
            if np.vdot(point, image) > 0:  # uphill: start anew without momentum
                following, ahead = 1.0, 0.0
            np.multiply(image, kind(ahead), out=point)
            point += new
            image, new = new, image
            momentum = following
            if change <= self._options.change * total:
                self.stopped = "change"
                break
        self._look(self._options.iterations)
        return image

    def _curvature(self, start: RealArray) -> float:
        """Largest singular value of A squared, by power steps from Aᵀg; a little more, to be sure."""
        vector: RealArray = start + start.dtype.type(1e-3 * np.abs(start).max()) * np.random.default_rng(
            0
        ).standard_normal(start.shape, start.dtype)
        value = 1.0
        for _ in range(_POWER_STEPS):
            vector /= np.linalg.norm(vector) or 1.0
            vector = self._adjoint(self._forward(vector))
            value = float(np.linalg.norm(vector))
        return _SAFETY * (value or 1.0)

    def _forward(self, volume: RealArray) -> RealArray:
        self.products += 1
        return self._model.forward(volume, cancelled=self._cancelled)

    def _adjoint(self, traces: RealArray) -> RealArray:
        self.products += 1
        return self._model.backward(traces, cancelled=self._cancelled)

    def _look(self, iteration: int) -> None:
        if self._progress is not None:
            misfit = f", misfit {100 * self.residuals[-1]:.1f} %" if self.residuals else ""
            self._progress(f"iterations{misfit}", iteration, self._options.iterations)
        if self._cancelled is not None and self._cancelled():
            raise Cancelled("cancelled during: iterations")


def _slices(
    depth_range: tuple[float, float] | None, samples: int, factor: int, step: float
) -> tuple[int, int, tuple[int, int]]:
    """First fine slice, one past the last, and first and last coarse slice around them."""
    end = -(-samples // factor) - 1
    if depth_range is None:
        return 0, samples, (0, end)
    low, high = checks.depths(depth_range, (samples - 1) * step)
    first, last = int(np.ceil(low / step - 1e-6)), int(np.floor(high / step + 1e-6)) + 1
    if last <= first:
        raise InvalidInput("depth_range", depth_range, f"a range with at least one slice (step {step:.4g} m)")
    return first, last, (first // factor, min(end, -(-last // factor)))


def _bytes(
    model: ForwardOperator, measured: RealArray, options: Iterative, factor: int, upsampling: int, depths: int
) -> int:
    """Bound of what a run allocates: modes, scratch, traces and images of the iterations, or the fine image."""
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
    g = model.geometry
    lateral = [
        (np.arange(n * upsampling, dtype=np.float64) / upsampling - n // 2) * (X / n)
        for X, n in zip(g.aperture, g.modes, strict=True)
    ]
    spacing = (*(X / n / upsampling for X, n in zip(g.aperture, g.modes, strict=True)), step)
    axes = Axes(lateral[0], lateral[1] if len(lateral) == 2 else None, depths)
    return Volume(values, axes, spacing, g.sound_speed)
