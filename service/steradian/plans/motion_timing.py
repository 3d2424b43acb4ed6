"""Time between points: motion, settling and retuning."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from steradian.plans.scanner_model import Motion, Tuning


@dataclass(frozen=True)
class MotionTiming:
    """Timing of the motion, tuning, laser and link between two pulses.

    When a record is over, the beam moves and settles while the laser tunes; the next pulse of a laser that runs freely
    is used. So a move a little longer than the rest of the pulse period costs a second period.

    Attributes
    ----------
    motion, tuning
        How beam and bias wavelength get from point to point.
    pulse_rate
        Pulses per second.
    record
        Length of a record in s.
    """

    motion: Motion
    tuning: Tuning
    pulse_rate: float
    record: float

    def move_times(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the time (M,) to move to and settle at each of the points (M, 2) in turn; the first is 0 away."""
        way = np.linalg.norm(np.diff(points, axis=0, prepend=points[:1]), axis=1)
        return np.where(way > 0, way / self.motion.speed + self.motion.settling, 0.0)

    def retune_times(self, bias: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the time (M,) to tune to each of the wavelengths (M,) in turn; the first is already tuned."""
        change = np.abs(np.diff(bias, prepend=bias[:1]))
        return np.where(change > 0, self.tuning.settling + change / self.tuning.speed, 0.0)

    def periods(self, points: NDArray[np.float64], bias: NDArray[np.float64] | None) -> NDArray[np.float64]:
        """Return the number of pulse periods (M,) until the first shot at each of the points in turn."""
        busy = self.move_times(points)
        if bias is not None:
            busy = np.maximum(busy, self.retune_times(bias))
        busy = np.where(busy > 0, busy + self.record, 0.0)
        return np.maximum(np.ceil(busy * self.pulse_rate - 1e-9), 1)

    def seconds(self, points: NDArray[np.float64], bias: NDArray[np.float64] | None) -> float:
        """Return the total time in seconds of one shot at each point in turn."""
        return float(self.periods(points, bias).sum()) / self.pulse_rate
