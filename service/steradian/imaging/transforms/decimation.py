"""Decimation of A-lines to the sampling rate that a frequency band needs."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, log10
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.progress import CancelCheck, Progress
from steradian.imaging.compute import thread_pool as workers
from steradian.imaging.transforms.grid_sizes import LINE
from steradian.imaging.volume import RealArray

_OVERSAMPLINGS = (1.06, 1.08, 1.1, 1.12, 1.15, 1.2, 1.25, 1.3, 1.4, 1.5, 1.75, 2.0)
OTHER_FACTORS = 500  # products of a tap and a sample that cost what the other steps take for a sample, about
MIN_SAVING = 0.9  # of the samples; a decimation to more of them is left
_VECTORS = 32  # taps are a multiple of this: no remainder for the processor to do one by one
_ROWS = 256  # A-lines decimated together


@dataclass(frozen=True, slots=True, eq=False)
class Decimation:
    """Decimation by a low-pass filter and resampling, which preserves the time spectrum within the band.

    Sample n of the result, at ``first`` + n·``every``, is the sum of the A-line's samples times a windowed sinc about
    that place. The result reaches beyond both ends of the A-line as far as the sinc does: nothing of it is cut off.
    Σ over the new samples of e^{−2πi f t} is Σ over the old ones: amplitudes are ``every`` times those in between.

    Parameters
    ----------
    every, first
        In samples of the A-line.
    starts, taps
        Sample n of the result is Σ_t taps[n, t]·(the A-line's sample starts[n] + t); (N',) and (N', w).
    """

    every: float
    first: float
    starts: NDArray[np.int64]
    taps: NDArray[np.float64]

    @property
    def samples(self) -> int:
        """Number of samples after decimation."""
        return len(self.starts)

    def bytes(self, count: int, threads: int, dtype: str) -> int:
        """Return the memory in bytes that :meth:`apply` needs for ``count`` A-lines."""
        longest = int(self.starts[-1]) + self.taps.shape[1]
        numbers = count * self.samples + self.taps.size + threads * _ROWS * longest
        return int(numbers) * np.dtype(dtype).itemsize

    def apply(
        self,
        traces: NDArray[Any],
        dtype: str,
        *,
        threads: int = 1,
        progress: Progress | None = None,
        cancelled: CancelCheck | None = None,
    ) -> RealArray:
        """Decimate A-lines (M, N) of any real type; non-finite values remain non-finite."""
        from steradian.imaging.transforms.windowed_sums import weighted_sums

        result: RealArray = np.empty((len(traces), self.samples), dtype)
        taps = self.taps.astype(dtype)

        def work(piece: int, space: None, flag: NDArray[np.uint8]) -> None:
            rows = slice(piece * _ROWS, (piece + 1) * _ROWS)
            with np.errstate(over="ignore"):
                part = np.ascontiguousarray(traces[rows], dtype)
            weighted_sums(part, self.starts, taps, result[rows])

        pieces = -(-len(traces) // _ROWS)
        workers.parallel_for(
            "decimation", pieces, lambda: None, work, threads=threads, progress=progress, cancelled=cancelled
        )
        return result


def plan_decimation(samples: int, band: float, accuracy: float) -> Decimation | None:
    """Return the decimation for frequencies below ``band``; None if the benefit is small.

    Parameters
    ----------
    samples
        Of an A-line.
    band
        In cycles a sample, at most ½.
    accuracy
        Relative, of a frequency in the band; of what is above it that much comes into it.
    """
    # Kaiser's formulas (J. F. Kaiser, Proc. IEEE ISCAS 1974): steepness and length for an attenuation in dB
    attenuation = max(60.0, -20 * log10(accuracy))
    beta = 0.1102 * (attenuation - 8.7)
    best: tuple[float, int, float, float] | None = None
    for oversampling in _OVERSAMPLINGS:
        every = 0.5 / (band * oversampling)
        reach = 0.5 * (attenuation - 7.95) / (2.285 * 2 * np.pi * (1 - 1 / oversampling))  # samples of the result
        count = LINE * (floor((samples - 1) / every + 2 * reach) // LINE + 1)
        cost = count * (OTHER_FACTORS + 2 * reach * every)
        if best is None or cost < best[0]:
            best = cost, count, every, reach
    assert best is not None  # noqa: S101
    _, count, every, reach = best
    if count > MIN_SAVING * samples:
        return None
    # Kaiser-windowed sinc
    places = np.arange(count) - reach  # in samples of the result, from the A-line's first
    width = min(samples, _VECTORS * -(-(floor(2 * reach * every) + 1) // _VECTORS))
    starts = np.clip(np.ceil((places - reach) * every), 0, samples - width).astype(np.int64)
    v = places[:, None] - (starts[:, None] + np.arange(width)) / every
    root = np.sqrt(np.maximum(1 - (v / reach) ** 2, 0))
    taps = np.where(np.abs(v) <= reach, np.sinc(v) * np.i0(beta * root) / np.i0(beta), 0.0)
    return Decimation(every, -reach * every, starts, taps)
