"""Inference of the meaning of an array's axes from the samples: quiet beginnings, similar neighbours.

A record begins before the sound arrives, so an array's first part along time is quiet, while the first sensors are as
loud as the others. A-lines of sensors side by side are alike but for a delay of at most their distance over the speed
of sound. Neither needs units or a model; both can fail, and then :func:`time_axis` says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

BEGINNING = 0.05
"""Share of an axis that counts as its beginning."""
CLEAR = 0.5
"""The quietest beginning is time's where it has at most so much of the power of any other axis's beginning."""
SILENT, CHANCE = 1e-3, 6.0
HEARD = 0.02
"""Least relative power of the beginning of the other axes: where these are silent, too, nothing can be told."""
SLICES, BEGINNING_SLICES = 96, 64
"""Slices along the first axis that are looked at, and of its beginning."""
BROKEN, ALIKE, AROUND = 0.35, 0.4, 8
"""A break is a pair less than ``BROKEN`` times as alike as the ``AROUND`` pairs on either side, where these are at
least ``ALIKE``."""
MOST_LAG = 64
BLOCK = 1 << 21
"""Samples compared at a time."""
LOUD = 1e-3
"""A-lines with less than this share of the largest power say nothing."""


def time_axis(data: Any, axes: Sequence[int]) -> int | None:
    """Return the axis of an array (NumPy or HDF5) that is time by its samples; ``None`` if undecided.

    Parameters
    ----------
    data
        Array of two or three axes.
    axes
        The candidates.
    """
    powers = quiet_beginnings(data)
    ranked = sorted(axes, key=lambda axis: powers[axis])
    best = ranked[0]
    count = data.size * max(1, int(BEGINNING * data.shape[best])) // data.shape[best]
    limit = max(SILENT, min(CLEAR, 1 - CHANCE * np.sqrt(2 / count)))  # the power of few numbers varies by chance
    clear = np.isfinite(powers).all() and powers[best] <= limit * powers[ranked[1]]
    return ranked[0] if clear and powers[ranked[1]] >= HEARD else None


def quiet_beginnings(data: Any) -> NDArray[np.float64]:
    """Return, for each axis, the mean power of its first entries relative to the mean power of all samples."""
    count = data.shape[0]
    picked = np.unique(np.linspace(0, count - 1, min(count, SLICES)).round().astype(int))
    whole = np.stack([np.asarray(data[index], np.float64) for index in picked])
    first = np.asarray(data[: min(max(1, int(BEGINNING * count)), BEGINNING_SLICES)], np.float64)
    middle = np.median(whole)
    with np.errstate(invalid="ignore", over="ignore"):
        power = ((whole - middle) ** 2).mean()
        found = [((first - middle) ** 2).mean()]
        for axis in range(1, data.ndim):
            part = np.take(whole, range(max(1, int(BEGINNING * data.shape[axis]))), axis)
            found.append(((part - middle) ** 2).mean())
        return np.array(found) / power if power > 0 else np.full(data.ndim, np.nan)


def longest_delay(pitch: float, speed: float, interval: float) -> int:
    """Return the longest possible delay, in samples, between the signals of sensors ``pitch`` metres apart."""
    delay = pitch / (speed * interval) if speed > 0 and interval > 0 else 0.0
    return int(min(MOST_LAG, ceil(delay))) if np.isfinite(delay) else MOST_LAG


def likeness(lines: NDArray[Any], others: NDArray[Any], delay: int) -> NDArray[np.float64]:
    """Return the correlation (n,) of pairs of A-lines at their best delay; nan for pairs without signal."""
    first, second = (np.asarray(each, np.float64) for each in (lines, others))
    first, second = (each - each.mean(axis=1, keepdims=True) for each in (first, second))
    power = (first**2).sum(axis=1), (second**2).sum(axis=1)
    loudest = max(power[0].max(initial=0.0), power[1].max(initial=0.0))
    samples, best = first.shape[1], np.full(len(first), -1.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.sqrt(power[0] * power[1])
        for lag in range(-min(delay, samples - 1), min(delay, samples - 1) + 1):
            one = first[:, max(0, lag) : samples + min(0, lag)]
            two = second[:, max(0, -lag) : samples + min(0, -lag)]
            best = np.fmax(best, (one * two).sum(axis=1) / size)
    return np.where(np.minimum(*power) > LOUD * loudest, best, np.nan)


def first_break(lines: Any, delay: int) -> int | None:
    """Return the first row that, unlike its neighbours, is not similar to the next row; else ``None``."""
    pairs, step, found = len(lines) - 1, max(1, BLOCK // lines.shape[1]), [np.zeros(0)]
    for start in range(0, pairs, step):
        stop = min(start + step, pairs)
        found.append(likeness(lines[start:stop], lines[start + 1 : stop + 1], delay))
    alike = np.concatenate(found)
    for row in map(int, np.flatnonzero(alike < BROKEN)):
        around = np.delete(alike[max(0, row - AROUND) : row + AROUND + 1], min(row, AROUND))
        usual = float(np.nanmedian(around)) if np.isfinite(around).any() else 0.0
        if usual >= ALIKE and alike[row] < BROKEN * usual:
            return int(row)
    return None
