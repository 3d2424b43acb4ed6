"""Similarity of A-lines to their nearest neighbours, by the maximum of the cross-correlation.

Sound reaches two sensors at times that differ by at most their distance over its speed: only lags up to this, plausible
ones, are due to the object. Of each correlation the largest value within that lag around every lag is taken, and the
mean of these over the neighbours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import Cancelled
from steradian.core.progress import CancelCheck, Progress

CHUNK: Final = 512
"""A-lines correlated together: their correlations fit into the processor's second cache."""
DRIFTS: Final = 3
"""Lowest frequencies left out."""


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """Nearest neighbours of each sensor: (n, k) indices and (n, k) distances in metres."""

    index: NDArray[np.int64]
    distance: NDArray[np.float64]

    @classmethod
    def of(cls, positions: NDArray[np.float64], most: int) -> Neighbourhood:
        """Find up to ``most`` nearest neighbours of sensors at positions (n, d)."""
        from scipy.spatial import cKDTree

        near = min(most, len(positions) - 1)
        distance, index = cKDTree(positions).query(positions, near + 1, workers=2)
        distance, index = (np.asarray(each).reshape(len(positions), -1) for each in (distance, index))
        own = index == np.arange(len(index))[:, None]
        own[~own.any(axis=1), -1] = True  # many at one place: the sensor itself may not be among them
        return cls(index[~own].reshape(len(index), near), distance[~own].reshape(len(index), near))

    def median(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the median of values (n,) over each sensor's neighbours, shape (n,)."""
        return np.asarray(np.median(values[self.index], axis=1))


@dataclass(frozen=True, eq=False)
class CorrelationStatistics:
    """Maximum cross-correlation coefficients of each A-line with its neighbours, averaged, each (n,).

    Attributes
    ----------
    same, opposite
        At plausible lags, of the A-line and of the A-line with its sign turned.
    elsewhere
        At one implausible lag for all neighbours, the best one.
    lag
        That lag in s, to the plausible one.
    near
        Median over neighbours of the lag in s of the largest correlation within three plausible ones.
    scatter
        Median over neighbours of how far in s that lag is from its median.
    reach
        Largest plausible lag in s.
    power
        In the band that holds signal.
    floor
        Power of noise in that band, of a usual A-line.
    """

    same: NDArray[np.float32]
    opposite: NDArray[np.float32]
    elsewhere: NDArray[np.float32]
    lag: NDArray[np.float64]
    near: NDArray[np.float64]
    scatter: NDArray[np.float64]
    reach: NDArray[np.float64]
    power: NDArray[np.float32]
    floor: float


def compare(
    low: NDArray[np.complex64],
    step: float,
    around: Neighbourhood,
    time_zero: NDArray[np.float64],
    sound_speed: float,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> CorrelationStatistics:
    """Cross-correlate A-lines with their neighbours; arguments as in :func:`.bad_lines.find_bad_lines`.

    A-lines are filtered to the band that holds signal: each frequency by the share of the mean power above its floor.

    Raises
    ------
    Cancelled
        When ``cancelled`` returned ``True``.
    """
    from scipy.fft import irfft

    low, power, floor = _filtered(low)
    count, samples = len(low), 2 * (low.shape[1] - 1)
    zeros = time_zero - time_zero.min()
    if zeros.any():
        low *= np.exp(np.outer(zeros, np.arange(low.shape[1])) * (-2j * np.pi / (samples * step))).astype(np.complex64)
    farthest = around.distance.max(axis=1)
    same, opposite, elsewhere = (np.zeros(count, np.float32) for _ in range(3))
    lag, near, scatter = np.zeros(count), np.zeros(count), np.zeros(count)
    order = np.argsort(farthest, kind="stable")  # so that those with the same plausible lag come together
    for first in range(0, count, CHUNK):
        if cancelled is not None and cancelled():
            raise Cancelled("cancelled during: compare neighbours")
        rows = order[first : first + CHUNK]
        most = min(math.ceil(farthest[rows[-1]] / (sound_speed * step)), samples // 8)
        total, own = np.zeros((len(rows), samples), np.float32), low[rows]
        lags = np.zeros((len(rows), around.index.shape[1]))
        window = np.arange(-3 * most - 1, 3 * most + 2)
        for rank, others in enumerate(around.index[rows].T):
            across = irfft(own * np.conj(low[others]), samples, axis=1)
            opposite[rows] -= np.minimum(across[:, : most + 1].min(axis=1), across[:, -most - 1 :].min(axis=1))
            lags[:, rank] = window[across[:, window].argmax(axis=1)]
            total += _largest_within(across, most)
        opposite[rows] /= lags.shape[1]
        total /= lags.shape[1]
        same[rows], near[rows] = total[:, 0], np.median(lags, axis=1)
        scatter[rows] = np.median(np.abs(lags - near[rows, None]), axis=1)
        total[:, : 2 * most + 2], total[:, samples - 2 * most - 1 :] = -1, -1
        best = total.argmax(axis=1)
        elsewhere[rows] = total[np.arange(len(rows)), best]
        for row in np.flatnonzero(elsewhere[rows] > same[rows]).tolist():
            lag[rows[row]] = _middle(total[row], int(best[row]), 2 * most)
        if progress is not None:
            progress("compare neighbours", min(first + CHUNK, count), count)
    reach = farthest / sound_speed + step
    return CorrelationStatistics(
        same, opposite, elsewhere, step * lag, step * near, step * scatter, reach, power, floor
    )


def _filtered(low: NDArray[np.complex64]) -> tuple[NDArray[np.complex64], NDArray[np.float32], float]:
    """Return band-passed spectra scaled for unit correlation, the signal power, and the noise floor."""
    mean: NDArray[np.float64] = np.asarray(np.mean(np.abs(low) ** 2, axis=0, dtype=np.float64))
    inner = np.sort(mean[DRIFTS:-1])
    noise = float(inner[: max(1, len(inner) // 8)].mean())
    weight = np.clip(mean - noise, 0, None) / np.maximum(mean, 1e-300)
    weight[:DRIFTS], weight[-1] = 0, 0
    low = low * weight.astype(np.float32)
    power: NDArray[Any] = 2 * np.sum(low.real**2 + low.imag**2, axis=1)
    low *= (np.sqrt(2.0 * (low.shape[1] - 1)) / np.sqrt(np.maximum(power, 1e-30)))[:, None]
    return low, power, float(2 * noise * np.sum(weight**2))


def _middle(total: NDArray[np.float32], best: int, most: int) -> float:
    """Return the middle of the plateau around the ``best`` lag, within ``most`` lags, of a periodic function.

    Lags of the second half of the period are negative.
    """
    steps = np.arange(-most, most + 1)
    around = total[(best + steps) % len(total)]
    middle = best + float(steps[around >= 0.97 * around.max()].mean())
    return (middle + len(total) / 2) % len(total) - len(total) / 2


def _largest_within(across: NDArray[np.float32], most: int) -> NDArray[np.float32]:
    """Return the running maximum within ±``most`` samples, of periodic rows (n, N)."""
    size, wide = across.shape[1], 2 * most + 1
    found = np.concatenate([across[:, size - most :], across, across[:, :most]], axis=1)
    width = 1
    while width < wide:
        step = min(width, wide - width)
        found = np.maximum(found[:, :-step], found[:, step:])
        width += step
    return found
