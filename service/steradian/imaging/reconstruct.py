"""Traces to volume in one call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from steradian.errors import InvalidInput
from steradian.imaging import checks
from steradian.imaging.band import upper_limit
from steradian.imaging.checks import Sensors
from steradian.imaging.iterative_options import Iterative
from steradian.imaging.plan import ReconstructionPlan
from steradian.imaging.response import Correction
from steradian.imaging.tables import Method as DirectMethod
from steradian.imaging.transforms.windows import Shape, Window
from steradian.imaging.volume import Volume
from steradian.progress import IsCancelled, Progress
from steradian.ranges import SAMPLING_INTERVAL

if TYPE_CHECKING:
    from steradian.imaging.iterative import IterativeResult

Method: TypeAlias = DirectMethod | Literal["iterative"]


def reconstruct(
    traces: ArrayLike,
    positions: ArrayLike | Sensors,
    *,
    sampling_interval: float,
    sound_speed: float,
    aperture: float | Sequence[float] | None = None,
    modes: int | Sequence[int],
    weights: ArrayLike | Literal["voronoi"] | None = None,
    upsampling: int = 1,
    depth_range: tuple[float, float] | None = None,
    method: Method = "nedner",
    tolerance: float = 1e-4,
    window: Shape | Window = "kaiser-bessel",
    time_zero: float = 0.0,
    time_padding: float = 1.0,
    lateral_padding: float | None = None,
    wrap: bool = False,
    highest_frequency: float | Literal["signal"] | None = None,
    depth_step: float | None = None,
    correction: Correction | None = None,
    iterative: Iterative | None = None,
    on_fit: Callable[[IterativeResult], None] | None = None,
    scale: float = 1.0,
    dtype: DTypeLike | None = None,
    memory_limit: int | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
    cancelled: IsCancelled | None = None,
) -> Volume:
    """Reconstruct initial pressure from A-lines recorded at points of a plane (3-D) or of a line (2-D).

    Parameters
    ----------
    traces
        A-lines, shape (M, N_t), floating or integer; column n was recorded at ``time_zero`` + n·dt.
    positions
        Sensors in metres, shape (M, 2), or (M,) in 2-D; the origin is the middle of the aperture. Or a
        :class:`steradian.Mask`, which has weights and aperture of its own.
    sampling_interval
        dt in seconds.
    sound_speed
        c in m/s. The depth step is c·dt, if nothing else is asked for.
    aperture
        Lateral period X in metres, one number or (X, Y); None: the mask's.
    modes
        Lateral image points N over the aperture, one number or (Nx, Ny). More than the sensors' own sampling sharpens
        the image: the spectrum repeats, and κ sorts it.
    weights
        h_m in m² (m in 2-D), shape (M,): areas of the sensors' cells, whose sum is the *sensed* area (the disc that an
        equi-steradian mask covers, N·pitch along an axis of a grid), not the aperture's. With it the image has the
        object's amplitude as far as that area lets it be seen. None: the mask's, else, as for "voronoi", found from the
        positions, see :func:`steradian.imaging.weights.sensed_outline` (0.6 s for fifty thousand scattered sensors).
        Sensors at the same place are allowed, their contributions add up. None may be negative, and a sum that cannot
        be that of areas is refused.
    upsampling
        Lateral image points per mode: sinc interpolation of the finished image, for looks.
    depth_range
        First and last depth in metres; only these slices are computed in the end. None: the record's.
    method
        "nedner": exact κ, any sensors; becomes "ner" by itself where all sensors are on a grid (a part of one, too).
        "linear", "nearest": κ interpolated between the frequencies of the record doubled with zeros, as k-Wave does.
        "interpolated": the grid (the sensors', or that of the modes) is filled linearly from the sensors first, and
        ``weights`` play no part.
        "iterative": the image that fits the A-lines best among those a regulariser prefers
        (:mod:`steradian.imaging.iterative`, whose function also tells how it was found); ``weights`` play no part, and
        it takes no ``window``, ``time_padding`` or ``max_gain`` of a correction.
    tolerance
        Relative l2 error of the image's spectrum against the direct sums; chooses window and grids.
    window
        Shape of the interpolation window, whose width follows from the tolerance; or a window of given width and
        oversampling such as the paper's ``kaiser_bessel(6, 2.0)``.
    time_zero
        Time of the first sample after the laser pulse, in s.
    time_padding, lateral_padding
        Factors from 1 by which record and aperture are extended with zeros: against deep reflectors that fold back, and
        sources outside the aperture. The image's points stay where they are. Lateral None: 1, and as much as it needs
        for "iterative". Records whose length has a prime factor above 127 get a few zeros more.
    wrap
        Allow sensors outside the aperture; they count where the periodic aperture has them.
    highest_frequency
        Leave out what is above, in Hz: κ ends there. The run then costs about its share of the Nyquist frequency,
        0.5/dt, and the image has as many slices as that band needs. "signal": where the A-lines' signal ends in noise
        (:func:`steradian.imaging.band.signal_band`). None: all. Not for "iterative", whose options have one.
    depth_step
        Distance of slices in metres, at most, from c·dt: with ``highest_frequency`` the image is interpolated (zeros
        above the band) to as many slices as that takes. None: c·dt, or with a limit as far apart as the band allows.
    correction
        Of the film's response over frequency and angle: a regularised filter, or for "iterative" part of the model.
    iterative
        Regulariser and stopping rule of that method, and of no other.
    on_fit
        Called with how the image was found, by that method.
    scale
        Factor of the traces (pressure per count).
    dtype
        Working precision and that of the image, float32 or float64; None: float32, float64 where the tolerance is below
        5e-6.
    memory_limit
        Refuse to start if more bytes than this are needed, image included; None: more than are available.
    threads
        None: all processors this process may use.
    progress, cancelled
        See :mod:`steradian.progress`.

    Returns
    -------
    Volume
        Indexed [x, y, z] ([x, z] in 2-D).

    Raises
    ------
    InvalidInput
        If anything is out of range.
    Cancelled
        If ``cancelled`` said so.
    """
    checks.choice("method", method, (*get_args(DirectMethod), "iterative"))
    data = np.asarray(traces)
    if data.ndim != 2:
        raise InvalidInput("traces", f"an array of shape {data.shape}", "shape (M, N_t): one row a sensor")
    if method == "iterative":
        _refuse_unused(window, time_padding, correction)
        if highest_frequency is not None or depth_step is not None:
            name, value = (
                ("depth_step", depth_step) if highest_frequency is None else ("highest_frequency", highest_frequency)
            )
            raise InvalidInput(name, value, "None with the method iterative, whose options have a highest_frequency")
        from steradian.imaging.iterative import reconstruct_iteratively

        found = reconstruct_iteratively(
            data,
            positions,
            sampling_interval=sampling_interval,
            sound_speed=sound_speed,
            aperture=aperture,
            modes=modes,
            options=iterative,
            upsampling=upsampling,
            depth_range=depth_range,
            tolerance=tolerance,
            time_zero=time_zero,
            lateral_padding=lateral_padding,
            wrap=wrap,
            scale=scale,
            response=correction.response if correction else None,
            dtype=dtype,
            memory_limit=memory_limit,
            threads=threads,
            progress=progress,
            cancelled=cancelled,
        )
        if on_fit is not None:
            on_fit(found)
        return found.volume
    if iterative is not None:
        raise InvalidInput(
            "iterative", "given", f"None with the method {method}; these options are of 'iterative' alone"
        )
    plan = ReconstructionPlan(
        positions,
        samples=data.shape[1],
        sampling_interval=sampling_interval,
        sound_speed=sound_speed,
        aperture=aperture,
        modes=modes,
        weights=weights,
        upsampling=upsampling,
        depth_range=depth_range,
        method=method,
        tolerance=tolerance,
        window=window,
        time_zero=time_zero,
        time_padding=time_padding,
        lateral_padding=1.0 if lateral_padding is None else lateral_padding,
        wrap=wrap,
        highest_frequency=upper_limit(
            highest_frequency, data, SAMPLING_INTERVAL.check("sampling_interval", sampling_interval)
        ),
        depth_step=depth_step,
        correction=correction,
        dtype=dtype,
        memory_limit=memory_limit,
        threads=threads,
    )
    volume = plan.run(data, scale=scale, progress=progress, cancelled=cancelled)
    assert isinstance(volume, Volume)  # noqa: S101
    return volume


def _refuse_unused(window: Shape | Window, time_padding: float, correction: Correction | None) -> None:
    """Refuse what the method iterative would not use, if it is not the default."""
    allowed = "{} with the method iterative, which has no use for another"
    if window != "kaiser-bessel":
        raise InvalidInput("window", window, allowed.format("kaiser-bessel"))
    if time_padding != 1:
        raise InvalidInput("time_padding", time_padding, allowed.format("1"))
    if not isinstance(correction, Correction | None):
        raise InvalidInput("correction", type(correction).__name__, "a Correction, or None")
    usual = Correction.__dataclass_fields__["max_gain"].default
    if correction is not None and correction.max_gain != usual:
        raise InvalidInput("correction.max_gain", correction.max_gain, allowed.format(f"{usual:g}"))
