"""Rate limiter for a simulated UART, because a pseudo-terminal has no rate of its own."""

from __future__ import annotations

BURST = 20_000
"""Bytes of so many µs of line time may go at once."""
MAX_BURST_SECONDS = 500_000
"""The same while the line is busy: a UART goes on sending while this process waits for a processor."""
BITS = 10
"""Start bit, eight data bits, stop bit."""


class BaudRateLimiter:
    """Token bucket in device time that limits the simulated line to its baud rate.

    Parameters
    ----------
    baud
        Baud rate; 0 for no limit.
    """

    def __init__(self, baud: int) -> None:
        self._rate = baud / BITS / 1e6
        self._tokens = 0.0
        self._at = 0
        self._busy = False

    @property
    def limited(self) -> bool:
        """Whether the line's rate is limited."""
        return self._rate > 0

    def available(self, now: int, wanted: int) -> int:
        """Return the number of bytes, at most ``wanted``, that may be sent at ``now`` (µs)."""
        if not self.limited:
            return wanted
        full = max(16.0, self._rate * (MAX_BURST_SECONDS if self._busy else BURST))
        self._tokens = min(full, self._tokens + self._rate * max(0, now - self._at))
        self._at = max(self._at, now)
        return min(wanted, int(self._tokens))

    def consume(self, count: int, *, busy: bool = False) -> None:
        """Subtract sent bytes from the bucket; ``busy``: the limit delayed further bytes."""
        self._busy = busy
        if self.limited:
            self._tokens -= count
