"""Quality inspection of raw A-lines: power, baseline, noise, arrival time, and bad A-lines.

Quiet part: the quietest of eight equal windows of an A-line, by variance. Bad A-lines are told by comparison with their
nearest neighbours: by quiet variance, power, and the sign and lag of the largest cross-correlation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.quality.bad_lines import NEIGHBOURS, BadLine, find_bad_lines
from steradian.quality.neighbour_correlation import Neighbourhood
from steradian.quality.saturation import flat_ends, is_saturated

CHUNK: Final = 4096
"""A-lines in memory as floating point at a time."""
WINDOWS: Final = 8
LOW_BAND: Final = 256
"""Samples to which A-lines are reduced, by their lowest frequencies, before they are compared."""


@dataclass(frozen=True, eq=False)
class SignalReport:
    """Result of an inspection of A-lines; values are in units of the traces.

    Attributes
    ----------
    histogram_kind
        ``codes``: of digitiser codes (integers); ``values``: of any other samples.
    edges, counts
        (B + 1,) and (B,) histogram of all samples.
    clipped_low, clipped_high
        Samples at the least and the greatest value, in A-lines where such samples follow each other.
    missing_codes
        Codes between the least and the greatest that no sample has; ``None`` for values.
    mid_scale_offset
        Mean of all samples, in codes; ``None`` for values.
    frequencies, spectrum_mean, spectrum_median
        (F,) Hz, and power of the quiet parts at each of them.
    power, baseline_mean, baseline_variance, noise
        (n,) variance of each A-line; mean and variance of its quiet part; standard deviation of its quiet part.
    arrival
        (n,) s after the laser pulse at which the first sample exceeds both 6 times the noise and a quarter of the
        A-line's peak; nan without one.
    bad
        Bad A-lines, by index.
    decidable
        Whether neighbours are alike enough to tell inverted and time-shifted A-lines, and dead ones with noise.
    """

    positions: NDArray[np.float64]
    samples: int
    sampling_interval: float
    histogram_kind: Literal["codes", "values"]
    edges: NDArray[np.float64]
    counts: NDArray[np.int64]
    clipped_low: int
    clipped_high: int
    missing_codes: int | None
    mid_scale_offset: float | None
    frequencies: NDArray[np.float64]
    spectrum_mean: NDArray[np.float64]
    spectrum_median: NDArray[np.float64]
    power: NDArray[np.float32]
    baseline_mean: NDArray[np.float32]
    baseline_variance: NDArray[np.float32]
    arrival: NDArray[np.float64]
    bad: tuple[BadLine, ...]
    decidable: bool

    @property
    def noise(self) -> NDArray[np.float32]:
        """Standard deviation (n,) of each A-line's quiet part."""
        return np.sqrt(self.baseline_variance)


def inspect_signals(
    traces: NDArray[np.number[Any]],
    sampling_interval: float,
    positions: NDArray[np.float64],
    *,
    time_zero: NDArray[np.float64] | float = 0.0,
    scale: NDArray[np.float32] | float = 1.0,
    sound_speed: float = 1500.0,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> SignalReport:
    """Inspect A-lines block by block, after a first pass for minimum and maximum.

    Parameters
    ----------
    traces
        (n, N_t) A-lines; integers are digitiser codes.
    sampling_interval
        Seconds.
    positions
        (n, 1) or (n, 2) metres.
    time_zero
        Scalar or (n,) seconds of the first sample after the laser pulse.
    scale
        Scalar or (n,) pressure per unit of the traces, so that A-lines of unlike gain can be compared.
    sound_speed
        Metres per second; bounds the plausible lag between neighbours.
    progress, cancelled
        See :mod:`steradian.core.progress`.

    Raises
    ------
    InvalidInput
        When the arrays do not fit together.
    Cancelled
        When ``cancelled`` returned ``True``.
    """
    _check(traces, sampling_interval, positions)
    count, samples = traces.shape
    zeros = np.broadcast_to(np.asarray(time_zero, np.float64), (count,))
    power, mean, variance = (np.zeros(count, np.float32) for _ in range(3))
    arrival, ends = np.full(count, np.nan), np.zeros((count, 3), np.int64)
    bins = min(LOW_BAND, samples) // 2
    low = np.empty((count, bins + 1), np.complex64)
    window = samples // WINDOWS
    spectra = np.empty((count, window // 2 + 1), np.float32)
    histogram = Histogram.of(traces)
    for first in range(0, count, CHUNK):
        if cancelled is not None and cancelled():
            raise Cancelled("cancelled during: inspect A-lines")
        some = slice(first, first + CHUNK)
        block = np.asarray(traces[some])
        histogram.add(block)
        ends[some] = flat_ends(block)
        block = block.astype(np.float32)
        power[some] = block.var(axis=1)
        quiet = _quiet(block, window)
        mean[some], variance[some] = quiet.mean(axis=1), quiet.var(axis=1)
        block -= mean[some, None]
        spectra[some] = np.abs(_rfft((quiet - mean[some, None]) * np.hanning(window).astype(np.float32))) ** 2
        arrival[some] = _arrivals(np.abs(block), variance[some]) * sampling_interval + zeros[some]
        low[some] = _rfft(block)[:, : bins + 1]
        if progress is not None:
            progress("inspect A-lines", min(first + CHUNK, count), count)
    around = Neighbourhood.of(np.asarray(positions, np.float64), NEIGHBOURS)
    step = sampling_interval * samples / (2 * bins)
    strength = np.asarray(scale, np.float64)
    squared = np.broadcast_to((strength / (np.median(strength) or 1.0)) ** 2, (count,)).astype(np.float32)
    heard, quiet = power * squared, variance * squared
    bad, decidable = find_bad_lines(
        low, step, around, heard, quiet, is_saturated(ends), zeros, sound_speed, progress, cancelled
    )
    return SignalReport(
        positions=np.asarray(positions, np.float64),
        samples=samples,
        sampling_interval=sampling_interval,
        **histogram.figures(),
        frequencies=np.asarray(np.fft.rfftfreq(window, sampling_interval), np.float64),
        spectrum_mean=spectra.mean(axis=0, dtype=np.float64),
        spectrum_median=np.median(spectra, axis=0).astype(np.float64),
        power=power,
        baseline_mean=mean,
        baseline_variance=variance,
        arrival=arrival,
        bad=bad,
        decidable=decidable,
    )


class Histogram:
    """Incremental histogram of samples."""

    def __init__(self, low: float, high: float, is_codes: bool) -> None:
        self.is_codes, self.low, self.high = is_codes, low, high
        steps = int(high - low) + 1 if is_codes else 256
        self.counts, self.total, self.number = np.zeros(steps, np.int64), 0.0, 0
        self.clipped = [0, 0]

    @classmethod
    def of(cls, traces: NDArray[np.number[Any]]) -> Histogram:
        """Return an empty histogram for given samples; integers of more than 16 bits are counted as floats."""
        low, high = float(traces.min()), float(traces.max())
        return cls(low, high, traces.dtype.kind in "iu" and high - low < 1 << 16)

    def add(self, block: NDArray[np.number[Any]]) -> None:
        """Add the samples of a block of A-lines (n, N_t) to the histogram."""
        if self.is_codes:
            self.counts += np.bincount((block.ravel().astype(np.int32) - int(self.low)), minlength=len(self.counts))
        else:
            self.counts += np.histogram(block, len(self.counts), (self.low, self.high))[0]
        for side, end in enumerate((self.low, self.high)):
            at_end = block == end
            follow = (at_end[:, 1:] & at_end[:, :-1]).any(axis=1)
            self.clipped[side] += int(np.count_nonzero(at_end[follow]))
        self.total, self.number = self.total + float(block.sum(dtype=np.float64)), self.number + block.size

    def figures(self) -> dict[str, Any]:
        """Return the histogram's fields of a :class:`SignalReport`; at most 512 bins."""
        edges = np.linspace(self.low, self.high, len(self.counts) + 1)
        counts = self.counts
        if self.is_codes:
            wide = -(-len(counts) // 512)
            edges = np.arange(self.low - 0.5, self.low - 0.5 + wide * (-(-len(counts) // wide)) + 1, wide)
            counts = np.add.reduceat(counts, np.arange(0, len(counts), wide))
        return {
            "histogram_kind": "codes" if self.is_codes else "values",
            "edges": edges,
            "counts": counts,
            "clipped_low": self.clipped[0],
            "clipped_high": self.clipped[1],
            "missing_codes": int(np.count_nonzero(self.counts == 0)) if self.is_codes else None,
            "mid_scale_offset": self.total / self.number if self.is_codes else None,
        }


def _check(traces: NDArray[Any], interval: float, positions: NDArray[Any]) -> None:
    if traces.ndim != 2 or len(traces) == 0 or traces.shape[1] < 4 * WINDOWS:
        raise InvalidInput("traces", traces.shape, f"(n, samples): n ≥ 1 A-lines of at least {4 * WINDOWS} samples")
    if positions.ndim != 2 or len(positions) != len(traces):
        raise InvalidInput("positions", positions.shape, f"({len(traces)}, 1) or ({len(traces)}, 2), in metres")
    if not interval > 0:
        raise InvalidInput("sampling_interval", interval, "seconds, above 0")


def _quiet(block: NDArray[np.float32], window: int) -> NDArray[np.float32]:
    """Return the samples (n, window) of each A-line's window of least power."""
    parts = block[:, : WINDOWS * window].reshape(len(block), WINDOWS, window)
    return np.asarray(parts[np.arange(len(block)), parts.var(axis=2).argmin(axis=1)])


def _arrivals(size: NDArray[np.float32], variance: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the index (n,) of each A-line's first sample above the noise; nan without one."""
    least = np.maximum(6 * np.sqrt(variance), size.max(axis=1) / 4)
    over = size > least[:, None]
    return np.where(over.any(axis=1), over.argmax(axis=1), np.nan)


def _rfft(block: NDArray[np.float32]) -> NDArray[np.complex64]:
    from scipy.fft import rfft

    return np.asarray(rfft(block, axis=1, workers=2))
