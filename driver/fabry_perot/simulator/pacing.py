"""How fast a simulated UART carries bytes, since a pseudo-terminal itself paces none."""

from __future__ import annotations

BURST = 20_000
"""Bytes of so many µs of line time may go at once."""
BITS = 10
"""Start bit, eight data bits, stop bit."""


class Pacer:
    """A token bucket in device time.

    Parameters
    ----------
    baud
        Baud rate; 0 for no limit.
    """

    def __init__(self, baud: int) -> None:
        self._rate = baud / BITS / 1e6
        self._tokens = 0.0
        self._at = 0

    @property
    def limited(self) -> bool:
        """Whether there is a limit at all."""
        return self._rate > 0

    def allowance(self, now: int, wanted: int) -> int:
        """Return how many of ``wanted`` bytes may go at ``now`` (µs)."""
        if not self.limited:
            return wanted
        full = max(16.0, self._rate * BURST)
        self._tokens = min(full, self._tokens + self._rate * max(0, now - self._at))
        self._at = max(self._at, now)
        return min(wanted, int(self._tokens))

    def spend(self, count: int) -> None:
        """Count bytes that went."""
        if self.limited:
            self._tokens -= count
