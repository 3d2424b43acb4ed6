"""Line filters of tests, beside those of the simulator (``fabry_perot.simulator.line_faults``)."""

from __future__ import annotations

import random
from collections.abc import Callable

from fabry_perot.wire.framing import Deframer, encode_frame


class ByteFaults:
    """Line filter that drops, inserts or duplicates a byte in one of ``every`` bytes on average."""

    def __init__(self, seed: int, every: int) -> None:
        self._random, self._every = random.Random(seed), every
        self._left = self._gap()

    def _gap(self) -> int:
        return int(self._random.expovariate(1 / self._every))

    def __call__(self, data: bytes, now: int) -> bytes:
        """Return ``data`` with some bytes lost, inserted or duplicated."""
        out = b""
        while self._left < len(data):
            at, kind = self._left, self._random.randrange(3)
            middle = (b"", data[at : at + 1] + self._random.randbytes(1), data[at : at + 1] * 2)[kind]
            out, data = out + data[:at] + middle, data[at + 1 :]
            self._left = self._gap()
        self._left -= len(data)
        return out + data


class ChunkFaults:
    """Line filter that duplicates a chunk, or swaps it with the next, once in ``every`` chunks on average."""

    def __init__(self, seed: int, every: int) -> None:
        self._random, self._every, self._held = random.Random(seed), every, b""

    def __call__(self, data: bytes, now: int) -> bytes:
        """Return ``data`` unchanged, twice, or delayed until after the next chunk."""
        if not data:
            return b""
        held, self._held = self._held, b""
        if not held and self._random.randrange(self._every) == 0:
            if self._random.random() < 0.5:
                return data + data
            self._held = data
            return b""
        return data + held


class SlowReader:
    """Line filter that limits the rate to ``rate`` bytes per second, and queues the rest."""

    def __init__(self, rate: float) -> None:
        self._rate, self._queue, self._at, self._tokens = rate, b"", 0, 0.0

    def __call__(self, data: bytes, now: int) -> bytes:
        """Return the bytes that the rate permits."""
        self._queue += data
        self._tokens = min(self._rate * 0.02, self._tokens + self._rate * (now - self._at) * 1e-6)
        self._at = now
        count = int(self._tokens)
        out, self._queue = self._queue[:count], self._queue[count:]
        self._tokens -= len(out)
        return out


class FramesOfType:
    """Line filter that drops or repeats the frames of one type whose count ``which`` selects.

    Parameters
    ----------
    kind
        Message type.
    which
        Told how many of them were seen before, says whether this one is meant.
    copies
        How often a frame that is meant passes.
    """

    def __init__(self, kind: int, which: Callable[[int], bool], copies: int = 0) -> None:
        self._kind, self._which, self._copies, self.seen = kind, which, copies, 0
        self._deframer = Deframer()

    def __call__(self, data: bytes, now: int) -> bytes:
        """Return the frames that are not dropped."""
        out = b""
        for frame in self._deframer.feed(data):
            copies = 1
            if frame.type == self._kind:
                copies = self._copies if self._which(self.seen) else 1
                self.seen += 1
            out += encode_frame(frame) * copies
        return out


class Recorder:
    """Line filter that records the passing bytes, at most the last ``limit``."""

    def __init__(self, limit: int = 1 << 24) -> None:
        self.data, self._limit = b"", limit

    def __call__(self, data: bytes, now: int) -> bytes:
        """Record the bytes that pass through, and return them unchanged."""
        self.data = (self.data + data)[-self._limit :]
        return data


class Replay:
    """Line filter that inserts recorded bytes once, at a given time."""

    def __init__(self, data: bytes, at: int) -> None:
        self._data, self._at = data, at

    def __call__(self, data: bytes, now: int) -> bytes:
        """Return ``data``, once with the recorded bytes inserted before it."""
        if now < self._at:
            return data
        old, self._data = self._data, b""
        return old + data
