"""Simulation of 2-D wave propagation by a k-space method.

In a homogeneous medium each plane wave of the initial pressure oscillates as cos(c·|k|·t), which has no error of time
steps. Instead of an absorbing layer, the periodic domain is made so large that no wave comes round within the record.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging.compute import thread_pool as workers
from steradian.imaging.volume import Volume

_LINES, _STEPS = 16, 256


def propagate_2d(
    image: Volume,
    *,
    samples: int,
    sampling_interval: float,
    sound_speed: float,
    threads: int | None = None,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> NDArray[np.float32]:
    """Return the simulated pressure on the line z = 0 at the columns of a 2-D initial-pressure image.

    Parameters
    ----------
    image
        Initial pressure [x, z], such as :func:`steradian.phantoms.tree_2d`, on a grid that is fine enough for it; the
        grid's first depth is 0.
    samples
        N_t, the first at the laser pulse.
    sampling_interval
        In s; c·dt must not exceed the image's spacings divided by √2, or the highest waves alias.
    sound_speed
        In m/s.
    threads
        None: all processors this process may use, or as many as ``OMP_NUM_THREADS`` says.
    progress, cancelled
        See :mod:`steradian.core.progress`.

    Returns
    -------
    ndarray
        (N_x, N_t) float32: ideal point sensors in free space, in the unit of the image.

    Raises
    ------
    InvalidInput
        When the image is no image [x, z] from depth 0.
    Cancelled
        When ``cancelled`` said so.
    """
    if image.dimensions != 2 or abs(float(image.axes.z[0])) > 1e-9:
        raise InvalidInput("image", f"shape {image.values.shape}", "an image [x, z] whose first depth is 0")
    import scipy.fft

    from steradian.phantoms.forward_kernels import oscillate

    (nx, nz), (dx, dz) = image.values.shape, image.spacing
    reach = sound_speed * sampling_interval * samples
    # the sensors are at row 0: an image of the object a period away must be further than the record reaches
    columns = scipy.fft.next_fast_len(nx + int(np.ceil(reach / dx)) + 8)
    rows = scipy.fft.next_fast_len(nz + int(np.ceil(reach / dz)) + 8)
    spectrum = scipy.fft.rfft(image.values.astype(np.float64), columns, axis=0)  # [kx, z]
    spectrum = scipy.fft.fft(spectrum, rows, axis=1) / rows
    half = rows // 2 + 1
    # waves up and down have the same frequency and meet at z = 0
    folded = spectrum[:, :half].copy()
    folded[:, 1 : rows - half + 1] += spectrum[:, : half - 1 : -1]
    kx = 2 * np.pi * np.arange(len(folded)) / (columns * dx)
    kz = 2 * np.pi * np.arange(half) / (rows * dz)
    first = np.cos(sound_speed * sampling_interval * np.hypot(kx[:, None], kz[None, :]))
    real, imaginary, turns = folded.real.copy(), folded.imag.copy(), 2 * first
    state = np.stack([np.ones_like(first), first])
    sums = np.empty((samples, len(kx)), np.complex128)
    steps = range(0, samples, _STEPS)
    pieces = [slice(i, i + _LINES) for i in range(0, len(kx), _LINES)]

    def work(piece: int, _: None, flag: NDArray[np.uint8]) -> None:
        some = pieces[piece]
        own = np.ascontiguousarray(state[:, some])
        for start in steps:
            if flag[0]:
                return
            block = np.empty((min(_STEPS, samples - start), own.shape[1]), np.complex128)
            oscillate(turns[some], real[some], imaginary[some], own, block)
            sums[start : start + len(block), some] = block

    workers.parallel_for(
        "waves",
        len(pieces),
        lambda: None,
        work,
        threads=threads or workers.available_threads(),
        progress=progress,
        cancelled=cancelled,
    )
    traces = scipy.fft.irfft(sums, columns, axis=1)[:, :nx]
    return np.ascontiguousarray(traces.T, dtype=np.float32)
