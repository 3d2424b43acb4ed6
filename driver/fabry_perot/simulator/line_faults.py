"""Simulated line faults as composable, seeded filters: ``filter(bytes, now) -> bytes``.

The simulator puts them between itself and the line, tests put them between the two state machines; a filter knows
nothing of which. Times are µs of whichever clock drives it. A filter that holds bytes back gives them up at a later
call, so it must be called regularly, with ``b""`` when there is nothing new.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable

Filter = Callable[[bytes, int], bytes]


class FilterChain:
    """Chain of line filters, applied in order; ``filters`` may be changed at run time."""

    def __init__(self, filters: Iterable[Filter] = ()) -> None:
        self.filters = list(filters)

    def __call__(self, data: bytes, now: int) -> bytes:
        """Return ``data`` after all filters of the chain."""
        for item in self.filters:
            data = item(data, now)
        return data


class BitFlips:
    """Line filter that flips random bits.

    Parameters
    ----------
    seed
        Of the choice.
    rate
        Probability of each bit.
    """

    def __init__(self, seed: int, rate: float) -> None:
        self._random, self._rate = random.Random(seed), rate  # noqa: S311
        self._left = self._gap()

    def _gap(self) -> int:
        return int(self._random.expovariate(self._rate)) if self._rate > 0 else 1 << 62

    def __call__(self, data: bytes, now: int) -> bytes:
        """Return ``data`` with some bits flipped."""
        if self._left >= 8 * len(data):
            self._left -= 8 * len(data)
            return data
        out = bytearray(data)
        while self._left < 8 * len(out):
            out[self._left >> 3] ^= 1 << (self._left & 7)
            self._left += 1 + self._gap()
        self._left -= 8 * len(out)
        return bytes(out)


class Delay:
    """Line filter that holds all bytes from ``start`` on and releases them at ``stop``."""

    def __init__(self, start: int, stop: int) -> None:
        self.start, self.stop, self.held = start, stop, b""

    def __call__(self, data: bytes, now: int) -> bytes:
        """Return no bytes before ``stop``, then all held bytes."""
        if self.start <= now < self.stop:
            self.held += data
            return b""
        held, self.held = self.held, b""
        return held + data


class DropAll:
    """Line filter that drops all bytes from ``start`` until ``stop``."""

    def __init__(self, start: int, stop: int) -> None:
        self.start, self.stop = start, stop

    def __call__(self, data: bytes, now: int) -> bytes:
        """Return ``data``, but no bytes between ``start`` and ``stop``."""
        return b"" if self.start <= now < self.stop else data


class FrameLoss:
    """Line filter that drops a random share of all frames."""

    def __init__(self, seed: int, share: float) -> None:
        self._random, self._share, self._pending = random.Random(seed), share, b""  # noqa: S311

    def __call__(self, data: bytes, now: int) -> bytes:
        """Return the complete frames that are not dropped."""
        chunks = (self._pending + data).split(b"\0")
        self._pending = chunks.pop()
        kept = [chunk for chunk in chunks if chunk and self._random.random() >= self._share]
        return b"".join(b"\0" + chunk + b"\0" for chunk in kept)
