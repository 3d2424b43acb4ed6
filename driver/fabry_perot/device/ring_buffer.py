"""Ring buffer of A-lines that the host has not acknowledged yet."""

from __future__ import annotations

from collections import deque
from itertools import islice

from fabry_perot.wire.constants import ALL_FRAGMENTS
from fabry_perot.wire.encoding import Encoding
from fabry_perot.wire.messages import ALineHead, pack


class ALineRingBuffer:
    """Ring buffer of A-lines by number, freed only by acknowledgement and never overwritten.

    Parameters
    ----------
    capacity
        A-lines it holds.
    """

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.group = 1
        """Most A-lines in one frame."""
        self.clear(0)

    def clear(self, plan: int, start: int = 0) -> int:
        """Restart for ``plan`` at number ``start``; return the number of unacknowledged A-lines dropped."""
        purged = len(self._blobs) if hasattr(self, "_blobs") else 0
        self.plan, self._fragment, self.peak = plan, 0, 0
        self.acknowledged = self.produced = self.sent = self.limit = start
        self._blobs: deque[tuple[int, int, bytes]] = deque()
        self._again: deque[tuple[int, int]] = deque()
        return purged

    @property
    def used(self) -> int:
        """Number of A-lines in the ring buffer."""
        return len(self._blobs)

    @property
    def free(self) -> int:
        """Number of A-lines that still fit into the ring buffer."""
        return self.capacity - len(self._blobs)

    def append(self, point: int, blob: bytes, encoding: int = 0) -> None:
        """Append an A-line; a full ring raises ``OverflowError`` because A-lines are never overwritten."""
        if self.free <= 0:
            raise OverflowError("the A-line ring is full")
        self._blobs.append((point, encoding, blob))
        self.produced += 1
        self.peak = max(self.peak, self.used)

    def acknowledge(self, durable: int, limit: int, missing: list[tuple[int, int]]) -> None:
        """Free A-lines below ``durable`` and queue the missing ones again; impossible counts are ignored."""
        if durable > self.produced:
            return
        while self.acknowledged < durable:
            self._blobs.popleft()
            self.acknowledged += 1
        if self.sent < self.acknowledged:
            self.sent, self._fragment = self.acknowledged, 0
        self.limit = max(self.limit, limit)
        for item in missing:
            if self.acknowledged <= item[0] < self.sent and item not in self._again:
                self._again.append(item)

    def resend_all(self) -> None:
        """Queue all unacknowledged A-lines again, to be sent when the host grants credit."""
        self.sent, self._fragment, self.limit = self.acknowledged, 0, 0
        self._again.clear()

    def next_payload(self, size: int) -> tuple[bytes, bool] | None:
        """Return the next ALINE payload of at most ``size`` bytes and whether it is a retransmission.

        Repairs go first; ``None`` when there is nothing to send or no credit.
        """
        room = size - 16
        while self._again:
            number, fragment = self._again[0]
            if number < self.acknowledged:
                self._again.popleft()
            elif fragment == ALL_FRAGMENTS:
                self._again.popleft()
                count = self._count(number, room)
                self._again.extendleft((number, index) for index in reversed(range(count)))
            else:
                self._again.popleft()
                if fragment < self._count(number, room):
                    return self._payload(number, fragment, room), True
        if self.sent >= min(self.produced, self.limit):
            return None
        together = self._together(room) if self.group > 1 and not self._fragment else 1
        if together > 1:
            payload = self._joint_payload(together)
            self.sent += together
            return payload, False
        payload = self._payload(self.sent, self._fragment, room)
        self._fragment += 1
        if self._fragment >= self._count(self.sent, room):
            self.sent, self._fragment = self.sent + 1, 0
        return payload, False

    def _together(self, room: int) -> int:
        """Return the number of next A-lines that may share a frame: whole, of equal length, of consecutive points."""
        begin = self.sent - self.acknowledged
        point, encoding, blob = self._blobs[begin]
        most = min(self.group, room // len(blob), min(self.produced, self.limit) - self.sent)
        if encoding != Encoding.INT16:
            return 1
        for count, other in enumerate(islice(self._blobs, begin, begin + most)):
            if (other[0], other[1], len(other[2])) != (point + count, encoding, len(blob)):
                return count
        return most

    def _joint_payload(self, count: int) -> bytes:
        begin = self.sent - self.acknowledged
        point, encoding, _ = self._blobs[begin]
        blobs = (blob for _, _, blob in islice(self._blobs, begin, begin + count))
        return pack(ALineHead(self.plan, self.sent, point, 0, 1, encoding, count - 1)) + b"".join(blobs)

    def _count(self, number: int, room: int) -> int:
        return -(-len(self._blobs[number - self.acknowledged][2]) // room)

    def _payload(self, number: int, fragment: int, room: int) -> bytes:
        point, encoding, blob = self._blobs[number - self.acknowledged]
        head = ALineHead(self.plan, number, point, fragment, self._count(number, room), encoding, 0)
        return pack(head) + blob[fragment * room : (fragment + 1) * room]
