"""Noise of one laser pulse, measured in the A-lines of a scan.

The noise is the standard deviation within the quietest of eight equal windows, the same window for all A-lines; the
signal is the mean peak of the strongest hundredth of the A-lines within the signal's band, as noise above it would
raise the peaks.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log, log10, sqrt
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging.signal.bandwidth import signal_band

WINDOWS: Final = 8
STRONGEST: Final = 0.01
"""Share of the A-lines whose peaks count as the signal."""
CHUNK: Final = 512
LEAST_RATIO: Final = 1.25
"""Least peak of the strongest A-lines over that expected of noise alone."""
_BINS: Final = 16
"""Bands of the noise's spectrum."""


@dataclass(frozen=True, eq=False)
class PulseNoise:
    """Signal-to-noise ratio and spectrum of the A-lines of single laser pulses.

    Attributes
    ----------
    decibels
        Peak of the strongest A-lines over the standard deviation of a sample's noise with one pulse, 20·log₁₀.
    spectrum
        (B,) relative power of the noise in B equal bands from 0 to the Nyquist frequency; ``None``: white.
    """

    decibels: float
    spectrum: NDArray[np.float64] | None = None

    def draw(self, shape: tuple[int, int], seed: int) -> NDArray[np.float32]:
        """Return noise (M, N_t) with standard deviation 1 and this spectrum."""
        noise = np.random.default_rng(seed).standard_normal(shape, dtype=np.float32)
        if self.spectrum is None:
            return noise
        from scipy.fft import irfft, rfft

        bins = np.linspace(0, 1, shape[1] // 2 + 1)
        centres = (np.arange(len(self.spectrum)) + 0.5) / len(self.spectrum)
        power = np.interp(bins, centres, self.spectrum)
        power /= power.mean()
        shaped = irfft(rfft(noise, axis=1) * np.sqrt(power).astype(np.float32), shape[1], axis=1)
        return np.asarray(shaped, np.float32)


def measure_pulse_noise(traces: ArrayLike, averages: ArrayLike = 1, scale: ArrayLike = 1.0) -> PulseNoise:
    """Measure the signal-to-noise ratio of one pulse in averaged A-lines.

    Parameters
    ----------
    traces
        (M, N_t) A-lines.
    averages
        Scalar or (M,) number of pulses averaged into each.
    scale
        Scalar or (M,) pressure per unit of the traces.

    Returns
    -------
    PulseNoise
        With the noise's spectrum.

    Raises
    ------
    InvalidInput
        When the A-lines are too short, or none of them stands out of the noise.
    """
    lines = np.asarray(traces)
    if lines.ndim != 2 or not len(lines) or lines.shape[1] < 8 * WINDOWS:
        raise InvalidInput("traces", lines.shape, f"(M, N_t): A-lines of at least {8 * WINDOWS} samples")
    factor = np.broadcast_to(np.asarray(scale, np.float32).reshape(-1, 1), (len(lines), 1))
    window = lines.shape[1] // WINDOWS
    variances, peaks = np.empty((len(lines), WINDOWS)), np.empty(len(lines))
    end = signal_band(lines, 1.0)[0]
    for first in range(0, len(lines), CHUNK):
        some = slice(first, first + CHUNK)
        values = lines[some].astype(np.float32) * factor[some]
        variances[some] = values[:, : WINDOWS * window].reshape(len(values), WINDOWS, window).var(axis=2)
        peaks[some] = np.abs(_low_passed(values - np.median(values, axis=1, keepdims=True), end)).max(axis=1)
    quiet = int(np.median(variances, axis=0).argmin())
    noise = float(np.sqrt(np.median(variances[:, quiet])))
    strongest = np.sort(peaks)[-max(1, round(STRONGEST * len(peaks))) :]
    signal = float(strongest.mean())
    if not noise > 0:
        raise InvalidInput("traces", "without noise", "A-lines with a quiet part whose noise can be measured")
    least = LEAST_RATIO * sqrt(min(1.0, 2 * end)) * sqrt(2 * log(lines.shape[1] / STRONGEST))
    if signal < least * noise:
        allowed = f"at least {least:.2g}; state the signal-to-noise ratio in dB instead"
        raise InvalidInput("traces", f"peaks of {signal / noise:.2g} times the noise", allowed)
    pulses = float(np.mean(np.broadcast_to(np.asarray(averages, np.float64), len(lines))))
    part = lines[:, quiet * window : (quiet + 1) * window].astype(np.float32) * factor
    return PulseNoise(20 * log10(signal / noise) - 10 * log10(pulses), _spectrum(part))


def _low_passed(values: NDArray[np.float32], end: float) -> NDArray[np.float32]:
    """Return A-lines (M, N_t) without frequencies above ``end`` in cycles a sample, where they have noise only."""
    from scipy.fft import irfft, rfft

    spectrum = rfft(values, axis=1)
    spectrum[:, int(end * values.shape[1]) + 1 :] = 0
    return np.asarray(irfft(spectrum, values.shape[1], axis=1), np.float32)


def _spectrum(part: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return the relative power (B,) of quiet parts (M, n) in equal bands."""
    from scipy.fft import rfft

    hann = np.hanning(part.shape[1]).astype(np.float32)
    power = (np.abs(rfft((part - part.mean(axis=1, keepdims=True)) * hann, axis=1)) ** 2).mean(axis=0)[1:]
    bands = np.array([each.mean() for each in np.array_split(power, min(_BINS, len(power)))], np.float64)
    return np.asarray(bands / bands.mean(), np.float64)
