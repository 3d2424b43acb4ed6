"""Repair of bad A-lines: sign of inverted ones, delay of time-shifted ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import Cancelled
from steradian.core.progress import CancelCheck, Progress
from steradian.quality.bad_lines import NEIGHBOURS, BadLine
from steradian.quality.neighbour_correlation import Neighbourhood

BLOCK: Final = 128
"""Shifted A-lines measured together, each with its neighbours."""
LOW_BAND: Final = 256
"""Samples to which A-lines were reduced before they were compared."""
NEAR: Final = 4.0
"""Steps of the comparison that found a shift, within which the shift is sought again with all samples."""


def measure_shifts(
    traces: NDArray[np.number[Any]],
    sampling_interval: float,
    positions: NDArray[np.float64],
    bad: Sequence[BadLine],
    *,
    time_zero: NDArray[np.float64] | float = 0.0,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> NDArray[np.float64]:
    """Measure the delays of time-shifted A-lines, by cross-correlation with their neighbours' sum.

    Neighbours that are bad themselves are left out of the sum; an A-line without any other keeps its shift. Between
    samples the largest correlation is found by a parabola through three.

    Parameters
    ----------
    traces
        (n, N_t) all A-lines.
    sampling_interval
        Seconds.
    positions
        (n, 1) or (n, 2) metres.
    bad
        All bad A-lines (:func:`steradian.quality.signals.inspect_signals`).
    time_zero
        Scalar or (n,) seconds of the first sample after the laser pulse.
    progress, cancelled
        See :mod:`steradian.core.progress`.

    Returns
    -------
    numpy.ndarray
        (k,) seconds by which the shifted ones among ``bad`` are late, in their order.

    Raises
    ------
    Cancelled
        When ``cancelled`` returned ``True``.
    """
    from scipy.fft import irfft, next_fast_len, rfft

    shifted = [line for line in bad if line.kind == "shifted"]
    found = np.array([line.shift for line in shifted])
    if not shifted:
        return found
    count, samples = traces.shape
    good = np.ones(count, bool)
    good[[line.aline for line in bad]] = False
    zeros = np.broadcast_to(np.asarray(time_zero, np.float64), (count,))
    around = Neighbourhood.of(np.asarray(positions, np.float64), NEIGHBOURS).index
    length = next_fast_len(2 * samples, real=True)
    turn = -2j * np.pi * np.fft.rfftfreq(length, sampling_interval)
    reach = NEAR * max(1.0, samples / LOW_BAND)
    for first in range(0, len(shifted), BLOCK):
        if cancelled is not None and cancelled():
            raise Cancelled("cancelled during: measure shifts")
        rows = np.array([line.aline for line in shifted[first : first + BLOCK]])
        others = around[rows]
        near = rfft(_centred(traces[others]), length, axis=2)
        near *= good[others][:, :, None] * np.exp(turn * (zeros[others] - zeros[rows, None])[:, :, None])
        across = irfft(rfft(_centred(traces[rows]), length, axis=1) * np.conj(near.sum(axis=1)), length, axis=1)
        coarse = (found[first : first + BLOCK]) / sampling_interval
        for number, (line, middle) in enumerate(zip(across, coarse.tolist(), strict=True), first):
            if line.any():
                found[number] = _peak_near(line, middle, reach) * sampling_interval
        if progress is not None:
            progress("measure shifts", min(first + BLOCK, len(shifted)), len(shifted))
    return found


def turn_sign(traces: NDArray[np.float32], rows: Sequence[int] | NDArray[np.int64]) -> None:
    """Invert the sign of A-lines about their median, in place, so that the digitiser's offset is preserved."""
    some = traces[rows]
    traces[rows] = 2 * np.median(some, axis=1, keepdims=True) - some


def _centred(traces: NDArray[np.number[Any]]) -> NDArray[np.float32]:
    """Return A-lines (…, N_t) with zero mean and unit norm."""
    some = traces.astype(np.float32)
    some -= some.mean(axis=-1, keepdims=True)
    norm = np.sqrt(np.sum(some**2, axis=-1, keepdims=True))
    return np.asarray(some / np.maximum(norm, np.float32(1e-30)))


def _peak_near(across: NDArray[np.floating[Any]], middle: float, reach: float) -> float:
    """Return the lag in samples of the maximum of a circular correlation within ``reach`` of ``middle``."""
    lags = np.arange(round(middle - reach), round(middle + reach) + 1)
    best = int(lags[across[lags % len(across)].argmax()])
    before, at, after = (float(across[lag % len(across)]) for lag in (best - 1, best, best + 1))
    curve = before - 2 * at + after
    return best + (min(max(0.5 * (before - after) / curve, -0.5), 0.5) if curve < 0 else 0.0)
