"""Recent traffic on a line, stored for diagnosis."""

from __future__ import annotations

from typing import NamedTuple

from fabry_perot.host.diagnosis import LineFault, classify, explain
from fabry_perot.wire.framing import LinkCounters

KEPT = 16_384
"""Last bytes that are kept."""


class Mark(NamedTuple):
    """Point in time: host time in µs, and the values of the counters."""

    time: int
    received: int
    good: int
    bad: int


class Traffic:
    """Buffer of the last received bytes, and counts since a point in time.

    Parameters
    ----------
    counters
        What the host's deframer counts.
    """

    def __init__(self, counters: LinkCounters) -> None:
        self._counters = counters
        self._recent = b""
        self.baud: int | None = None
        """Baud rate of the port in Bd, where it has one."""

    def take(self, data: bytes) -> None:
        """Append received bytes to the buffer, which retains the last ones."""
        self._recent = data[-KEPT:] if len(data) >= KEPT else (self._recent + data)[-KEPT:]

    def mark(self, now: int) -> Mark:
        """Return the present point in time with the counters."""
        counters = self._counters
        return Mark(now, counters.bytes_in, counters.good, counters.bad)

    def trouble(self, since: Mark) -> LineFault:
        """Return the line fault diagnosed from the bytes received since a point in time."""
        return classify(self._since(since))

    def explain(self, since: Mark, now: int) -> str:
        """Return a clause with the diagnosis and number of the bytes received since a point in time."""
        received, good, bad = (after - before for after, before in zip(self.mark(now)[1:], since[1:], strict=True))
        figures = f"{received:,} bytes in {(now - since.time) * 1e-6:.1f} s, {good:,} valid frames, {bad:,} damaged"
        return f"{explain(self._since(since), baud=self.baud)} ({figures})"

    def _since(self, since: Mark) -> bytes:
        count = min(self._counters.bytes_in - since.received, len(self._recent))
        return self._recent[len(self._recent) - count :]
