"""Clocks passed to the protocol's state machines: real and scaled time.

All times are whole microseconds (``int``), so that equal inputs give equal behaviour on every machine.
"""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Interface (typing protocol) of a clock in µs."""

    def now(self) -> int:
        """Return the present time in µs; it never runs backwards."""
        ...


_BOOTTIME_CLOCK = getattr(time, "CLOCK_BOOTTIME", getattr(time, "CLOCK_MONOTONIC", None))
"""The clock that counts the time a suspended computer sleeps: Linux has one for that, macOS' monotonic one does."""


class RealClock:
    """Monotonic clock of the host, which also advances while the computer is suspended."""

    def now(self) -> int:
        """Return the monotonic time in µs."""
        if _BOOTTIME_CLOCK is None:
            return time.monotonic_ns() // 1000
        return time.clock_gettime_ns(_BOOTTIME_CLOCK) // 1000


class ScaledClock:
    """Clock that runs ``rate`` times as fast as its base clock, and can be set back.

    A simulator that cannot compute in time calls :meth:`rewind_to`: simulated time then continues from where the
    simulation really is instead of jumping over work that was never done.

    Parameters
    ----------
    rate
        Simulated seconds per second of ``base`` (> 0).
    base
        The clock to scale.
    """

    def __init__(self, rate: float, base: Clock | None = None) -> None:
        if not rate > 0:
            raise ValueError(f"rate is {rate}; allowed: > 0")
        self.rate = rate
        self._base = base or RealClock()
        self._origin = self._base.now()
        self._offset = 0

    def now(self) -> int:
        """Return the simulated time in µs."""
        return self._offset + int((self._base.now() - self._origin) * self.rate)

    def rewind_to(self, at: int) -> None:
        """Set the time back to ``at`` µs, a time not later than now."""
        self._offset, self._origin = min(at, self.now()), self._base.now()
