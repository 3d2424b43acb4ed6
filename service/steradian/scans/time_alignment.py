"""Resampling of A-lines with different start times to a common time grid."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.validation import FloatArray

BLOCK = 512
"""A-lines transformed together."""
MARGIN_SAMPLES = 64
"""Zeros behind an A-line, so that the end of its interpolation does not come round to its beginning."""
INTEGER_TOLERANCE = 1e-6
"""Share of a sampling interval below which a shift is by whole samples."""


def common_grid(time_zero: FloatArray, sampling_interval: float, samples: int) -> tuple[FloatArray, int]:
    """Return the start of each A-line on a common time grid, in samples (M,), and the grid's length.

    Raises
    ------
    InvalidInput
        When they begin further apart than a record is long: then they have no time in common.
    """
    delays = (time_zero - time_zero.min()) / sampling_interval
    if delays.max() > samples:
        spread = 1e6 * float(np.ptp(time_zero))
        raise InvalidInput("time_zero", f"{spread:.4g} µs apart", f"at most {1e6 * samples * sampling_interval:.4g} µs")
    return delays, samples + math.ceil(delays.max() - INTEGER_TOLERANCE)


def align(traces: NDArray[np.float32], delays: FloatArray, samples: int) -> NDArray[np.float32]:
    """Resample A-lines to a common time grid, row m delayed by ``delays[m]`` samples; returns (M, ``samples``).

    Parts of a sample are shifted by a phase in the Fourier domain, which is exact for what the digitiser's band holds.
    What an A-line does not cover is 0; what lies outside the grid is left out.

    Parameters
    ----------
    traces
        (M, N_t).
    delays
        (M,) in samples.
    samples
        Length of the grid.
    """
    aligned = np.zeros((len(traces), samples), np.float32)
    for first in range(0, len(traces), BLOCK):
        part = slice(first, first + BLOCK)
        whole = np.floor(delays[part] + INTEGER_TOLERANCE).astype(np.int64)
        shifted = _later(traces[part], delays[part] - whole)
        for row, (start, line) in enumerate(zip(whole.tolist(), shifted, strict=True), first):
            begin, end = max(start, 0), min(start + len(line), samples)
            if begin < end:
                aligned[row, begin:end] = line[begin - start : end - start]
    return aligned


def _later(traces: NDArray[np.float32], shares: FloatArray) -> NDArray[np.float32]:
    """Delay each A-line by a fraction (0 … 1) of a sample in the Fourier domain; returns (M, N_t + 1)."""
    count, samples = traces.shape
    later = np.zeros((count, samples + 1), np.float32)
    later[:, :samples] = traces
    moved = np.flatnonzero(shares > INTEGER_TOLERANCE)
    if len(moved):
        from scipy.fft import irfft, next_fast_len, rfft  # an eighth of the API's start, which does not need it

        length = next_fast_len(samples + MARGIN_SAMPLES, real=True)
        turns = np.arange(length // 2 + 1) * (-2j * np.pi / length)
        spectrum = rfft(traces[moved].astype(np.float64), length, axis=1) * np.exp(turns * shares[moved, None])
        later[moved] = irfft(spectrum, length, axis=1)[:, : samples + 1]
    return later
