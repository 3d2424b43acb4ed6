"""One-shot reconstruction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging.engines.array_namespace import is_gpu_array, to_numpy
from steradian.imaging.film_response import InverseFilter
from steradian.imaging.iterative_options import Iterative
from steradian.imaging.parameters import Device, Method, Parameters
from steradian.imaging.plan import ReconstructionPlan
from steradian.imaging.signal.bandwidth import resolve_upper_frequency
from steradian.imaging.transforms.windows import Shape, Window
from steradian.imaging.validation import Sensors
from steradian.imaging.volume import Volume

if TYPE_CHECKING:
    from steradian.imaging.iterative.solve import IterativeResult


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
    correction: InverseFilter | None = None,
    iterative: Iterative | None = None,
    on_fit: Callable[[IterativeResult], None] | None = None,
    scale: float = 1.0,
    dtype: DTypeLike | None = None,
    memory_limit: int | None = None,
    threads: int | None = None,
    device: Device = "cpu",
    device_memory: int | None = None,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Volume:
    """Reconstruct initial pressure from A-lines recorded at points of a plane (3-D) or of a line (2-D).

    Parameters
    ----------
    traces
        A-lines, shape (M, N_t), floating or integer; column n was recorded at ``time_zero`` + n·dt. Of an array
        of a GPU (CuPy's, PyTorch's, with a ``device`` that is one) the image is CuPy's.
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
        positions, see :func:`steradian.imaging.geometry.sensor_areas.sensed_region` (0.6 s for fifty thousand
        scattered sensors). Sensors at the same place are allowed, their contributions add up. None may be negative, and
        a sum that cannot be that of areas is refused.
    upsampling
        Lateral image points per mode: sinc interpolation of the finished image, for looks.
    depth_range
        First and last depth in metres, within 0 … c·(``time_zero`` + N_t·dt); only these slices are computed in the
        end. None: from 0 to there; of a record that begins later after the pulse than a quarter of its length from
        c·``time_zero`` on (what is nearer is heard only by sensors far enough to its side).
    method
        "nedner": exact κ, any sensors; becomes "ner" by itself where all sensors are on a grid (a part of one, too).
        "linear", "nearest": κ interpolated between the frequencies of the record doubled with zeros, as k-Wave does.
        "interpolated": the grid (the sensors', or that of the modes) is filled linearly from the sensors first, and
        ``weights`` play no part.
        "iterative": the image that fits the A-lines best among those a regulariser prefers
        (:mod:`steradian.imaging.iterative.solve`, whose function also tells how it was found); ``weights`` play no
        part, and it takes no ``window``, ``time_padding`` or ``max_gain`` of a correction.
    tolerance
        Relative l2 error of the image's spectrum against the direct sums; chooses window and grids.
    window
        Shape of the interpolation window, whose width follows from the tolerance; or a window of given width and
        oversampling such as the paper's ``kaiser_bessel(6, 2.0)``.
    time_zero
        Time of the first sample after the laser pulse, in s, within ±0.5 ms; negative: the record begins before it. The
        image of a late record is that of the record with zeros in front, at about the cost of the record alone.
    time_padding, lateral_padding
        Factors from 1 by which record and aperture are extended with zeros: against deep reflectors that fold back, and
        sources outside the aperture. The image's points stay where they are. Lateral None: 1, and as much as it needs
        for "iterative". Records whose length has a prime factor above 127 get a few zeros more.
    wrap
        Allow sensors outside the aperture; they count where the periodic aperture has them.
    highest_frequency
        Leave out what is above, in Hz: κ ends there. The run then costs about its share of the Nyquist frequency,
        0.5/dt, and the image has as many slices as that band needs. "signal": where the A-lines' signal ends in noise
        (:func:`steradian.imaging.signal.bandwidth.signal_band`). None: all. Not for "iterative", whose options have
        one.
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
        None: all processors this process may use, or as many as ``OMP_NUM_THREADS`` says.
    device
        "cpu"; "gpu": a CUDA device (extra ``gpu``); "auto": that, where there is one and its memory suffices. Results
        are the same within the tolerance.
    device_memory
        Bytes of the GPU's memory to use at most; None: nine tenths of what is free. Larger images are made in pieces.
    progress, cancelled
        See :mod:`steradian.core.progress`.

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
    chosen = Parameters(
        sampling_interval=sampling_interval, sound_speed=sound_speed, aperture=aperture, modes=modes, weights=weights,
        upsampling=upsampling, depth_range=depth_range, method=method, tolerance=tolerance, window=window,
        time_zero=time_zero, time_padding=time_padding, lateral_padding=lateral_padding, wrap=wrap,
        highest_frequency=highest_frequency, depth_step=depth_step, correction=correction, iterative=iterative,
        dtype=dtype, memory_limit=memory_limit, threads=threads, device=device, device_memory=device_memory,
    )  # fmt: skip
    return reconstruct_with(
        chosen, traces, positions, on_fit=on_fit, scale=scale, progress=progress, cancelled=cancelled
    )


def reconstruct_with(
    chosen: Parameters,
    traces: ArrayLike,
    positions: ArrayLike | Sensors,
    *,
    on_fit: Callable[[IterativeResult], None] | None = None,
    scale: float = 1.0,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Volume:
    """Do the same with parameters that are one value; raises as :func:`reconstruct`."""
    data: Any = traces if is_gpu_array(traces) else np.asarray(traces)
    if data.ndim != 2:
        raise InvalidInput("traces", f"an array of shape {tuple(data.shape)}", "shape (M, N_t): one row a sensor")
    if chosen.method == "iterative":
        from steradian.imaging.iterative.solve import solve

        found = solve(data, positions, chosen, scale=scale, progress=progress, cancelled=cancelled)
        if on_fit is not None:
            on_fit(found)
        return found.volume
    limit = chosen.highest_frequency
    if limit == "signal":
        limit = resolve_upper_frequency(limit, to_numpy(data), chosen.sampling_interval)
    plan = ReconstructionPlan.from_parameters(positions, data.shape[1], replace(chosen, highest_frequency=limit))
    volume = plan.run(data, scale=scale, progress=progress, cancelled=cancelled)
    assert isinstance(volume, Volume)  # noqa: S101
    return volume
