"""Plane echoes of the boundaries between layers: arrival times of waves that reach all sensors at once.

Pulse-echo records of plane layers have them, and photoacoustic records where a boundary absorbs light. A plane echo is
a maximum of the envelope of the sensors' median A-line, which suppresses the sound of small objects.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import hilbert

COHERENT = 0.5
"""Least amplitude of a plane echo in the median A-line, relative to the median of the A-lines' envelopes there."""
ALONE = 0.5
"""Most amplitude of other maxima within the range searched, relative to the echo's."""
ABOVE_FLOOR = 10.0
"""Least amplitude of an echo, relative to the median over the record."""


@dataclass(frozen=True)
class PlaneEcho:
    """Arrival of a plane wave: times in s after the pulse at half the amplitude, rising, and at the maximum."""

    rise: float
    peak: float


class PlaneEchoes:
    """Search for plane echoes in a recording.

    Parameters
    ----------
    traces
        A-lines (M, N).
    interval, time_zero
        Sampling interval, and time of the first sample after the pulse, in s.
    """

    def __init__(self, traces: NDArray[Any], interval: float, time_zero: float) -> None:
        lines = np.asarray(traces, np.float64)
        self.median: NDArray[np.float64] = np.median(lines, axis=0)
        self._envelope = np.abs(hilbert(self.median - self.median.mean()))
        single = np.abs(hilbert(lines - lines.mean(axis=1, keepdims=True), axis=1))
        self._single = np.median(single, axis=0)
        self._floor = float(np.median(self._envelope))
        self._interval, self._zero = interval, time_zero

    def amplitude(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the envelope of the median A-line at times in s after the pulse, relative to its maximum there."""
        line = np.interp(times, self._zero + self._interval * np.arange(len(self._envelope)), self._envelope)
        return np.asarray(line / max(float(line.max()), np.finfo(float).tiny))

    def between(self, first: float, last: float) -> PlaneEcho | None:
        """Return the plane echo between two times in s after the pulse; None where there is not one clear one."""
        low = max(1, round((first - self._zero) / self._interval))
        high = min(len(self._envelope) - 1, round((last - self._zero) / self._interval) + 1)
        if high - low < 3:
            return None
        line = self._envelope
        peak = low + int(line[low:high].argmax())
        height = line[peak]
        start, end = peak, peak
        while start > 0 and line[start] > height / 2:
            start -= 1
        while end < len(line) - 1 and line[end] > height / 2:
            end += 1
        near = slice(max(low, peak - 2 * (peak - start)), peak + 2 * (end - peak) + 1)
        others = line[low:high].copy()
        others[near.start - low : near.stop - low] = 0
        clear = (
            low < peak < high - 1
            and height > ABOVE_FLOOR * self._floor
            and height > COHERENT * self._single[peak]
            and others.max() < ALONE * height
        )
        if not clear:
            return None
        fraction = (height / 2 - line[start]) / (line[start + 1] - line[start])
        a, b, c = line[peak - 1 : peak + 2]
        summit = peak + 0.5 * (a - c) / (a - 2 * b + c)
        return PlaneEcho(self._zero + (start + fraction) * self._interval, self._zero + summit * self._interval)
