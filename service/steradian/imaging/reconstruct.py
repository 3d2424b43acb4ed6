"""Traces to volume in one call."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from steradian.errors import InvalidInput
from steradian.imaging.iterative_options import Iterative
from steradian.imaging.plan import Method as DirectMethod
from steradian.imaging.plan import ReconstructionPlan
from steradian.imaging.response import Correction
from steradian.imaging.volume import Volume
from steradian.imaging.windows import Shape, Window
from steradian.progress import IsCancelled, Progress

Method: TypeAlias = DirectMethod | Literal["iterative"]


def reconstruct(
    traces: ArrayLike,
    positions: ArrayLike,
    *,
    sampling_interval: float,
    sound_speed: float,
    aperture: float | Sequence[float],
    modes: int | Sequence[int],
    weights: ArrayLike | Literal["voronoi"] | None = None,
    upsampling: int = 1,
    depth_range: tuple[float, float] | None = None,
    method: Method = "nedner",
    tolerance: float = 1e-4,
    window: Shape | Window = "kaiser-bessel",
    time_zero: float = 0.0,
    time_padding: float = 1.0,
    lateral_padding: float = 1.0,
    wrap: bool = False,
    correction: Correction | None = None,
    iterative: Iterative | None = None,
    scale: float = 1.0,
    dtype: Literal["float32", "float64"] | None = None,
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
        Sensors in metres, shape (M, 2), or (M,) in 2-D; the origin is the middle of the aperture.
    sampling_interval
        dt in seconds.
    sound_speed
        c in m/s. The depth step is c·dt.
    aperture
        Lateral period X in metres, one number or (X, Y).
    modes
        Lateral image points N over the aperture, one number or (Nx, Ny). More than the sensors' own sampling sharpens
        the image: the spectrum repeats, and κ sorts it.
    weights
        h_m in m² (m in 2-D), shape (M,), with the aperture's area as their sum; "voronoi": areas of the sensors' cells;
        None: equal. Sensors at the same place are allowed, their contributions add up.
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
        (:mod:`steradian.imaging.iterative`, whose function also tells how it was found); ``weights``, ``window`` and
        ``time_padding`` play no part, and the lateral padding is chosen if it is 1.
    tolerance
        Relative l2 error of the image's spectrum against the direct sums; chooses window and grids.
    window
        Shape of the interpolation window, whose width follows from the tolerance; or a window of given width and
        oversampling such as the paper's ``kaiser_bessel(6, 2.0)``.
    time_zero
        Time of the first sample after the laser pulse, in s.
    time_padding, lateral_padding
        Factors from 1 by which record and aperture are extended with zeros: against deep reflectors that fold back, and
        sources outside the aperture. The image's points stay where they are.
    wrap
        Allow sensors outside the aperture; they count where the periodic aperture has them.
    correction
        Of the film's response over frequency and angle: a regularised filter, or for "iterative" part of the model.
    iterative
        Regulariser and stopping rule of that method.
    scale
        Factor of the traces (pressure per count).
    dtype
        Working precision and that of the image; None: float32, float64 where the tolerance is below 5e-6.
    memory_limit
        Refuse to start if more bytes than this are needed, image included.
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
    data = np.asarray(traces)
    if data.ndim != 2:
        raise InvalidInput("traces", f"an array of shape {data.shape}", "shape (M, N_t): one row a sensor")
    if method == "iterative":
        from steradian.imaging.iterative import reconstruct_iteratively

        return reconstruct_iteratively(
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
            lateral_padding=lateral_padding if lateral_padding > 1 else None,
            wrap=wrap,
            scale=scale,
            response=correction.response if correction else None,
            dtype=dtype,
            memory_limit=memory_limit,
            threads=threads,
            progress=progress,
            cancelled=cancelled,
        ).volume
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
        lateral_padding=lateral_padding,
        wrap=wrap,
        correction=correction,
        dtype=dtype,
        memory_limit=memory_limit,
        threads=threads,
    )
    volume = plan.run(data, scale=scale, progress=progress, cancelled=cancelled)
    assert isinstance(volume, Volume)  # noqa: S101
    return volume
