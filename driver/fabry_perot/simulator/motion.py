"""Timing models of the simulated mirrors and laser pulses; times in µs, positions in nm."""

from __future__ import annotations

import math

import numpy as np

SETTLING = 400
"""Settling time of the mirrors, in µs."""
SPEED = 5_000
"""Speed of the beam on the film, in nm/µs (5 m/s)."""
PULSE_JITTER = 2
"""Largest timing jitter of a pulse, in µs."""


class Mirrors:
    """Timing model of two mirrors: travel at constant speed, then settling."""

    def __init__(self) -> None:
        self.x = self.y = 0

    def move(self, x: int, y: int, now: int) -> int:
        """Move to x, y and return the time at which the beam has settled."""
        distance = math.hypot(x - self.x, y - self.y)
        self.x, self.y = x, y
        return now + math.ceil(distance / SPEED) + (SETTLING if distance else 0)


class PulseTrain:
    """Timing model of a free-running Q-switched laser, with jitter; the shutter controls emission.

    Parameters
    ----------
    seed
        Of the timing jitter.
    """

    def __init__(self, seed: int) -> None:
        self._jitter = np.random.default_rng([seed, 0]).integers(0, PULSE_JITTER + 1, 1024).tolist()
        self._period = 20_000.0

    def rate(self, millihertz: int) -> None:
        """Set the pulse rate in mHz."""
        self._period = 1e9 / millihertz

    def next_pulse(self, after: int) -> int:
        """Return the time of the first pulse at or after ``after``."""
        slot = max(0, int(after / self._period) - 1)
        while True:
            time = int(slot * self._period) + self._jitter[slot % 1024]
            if time >= after:
                return int(time)
            slot += 1
