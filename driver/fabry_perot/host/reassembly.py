"""Reassembly of A-lines from fragments, with delivery of each exactly once and in order."""

from __future__ import annotations

from fabry_perot.errors import FrameError
from fabry_perot.host.aline import META_SIZE, ALineBatch, is_complete, parse_record
from fabry_perot.wire.constants import ALL_FRAGMENTS, MAX_MISSING
from fabry_perot.wire.encoding import Encoding
from fabry_perot.wire.messages import LAYOUT, ALineHead

_HEAD = LAYOUT[ALineHead]


class AlineReassembler:
    """Reassembler of A-lines, which delivers each exactly once, in order of number.

    Parameters
    ----------
    plan
        Plan uid; fragments of other plans are ignored.
    start
        First number wanted.
    window
        A-lines kept beyond the durably stored ones.
    repeat
        An A-line is asked for again after so many µs.
    """

    def __init__(self, plan: int, start: int, window: int, repeat: int) -> None:
        self.plan, self._window, self._repeat = plan, window, repeat
        self.durable = start
        """A-lines below this number are durably stored."""
        self.delivered = start
        """A-lines below this number were given to the consumer."""
        self.complete = start
        """A-lines below this number are here."""
        self.horizon = start
        """Numbers below this were sent by the device."""
        self.duplicates = self.damaged = self.repairs = 0
        self._lines: dict[int, tuple[int, bytes]] = {}
        self._parts: dict[int, list[bytes | None]] = {}
        self._asked: dict[int, int] = {}

    @property
    def limit(self) -> int:
        """Number below which the device may send A-lines (credit)."""
        return self.durable + self._window

    @property
    def has_gaps(self) -> bool:
        """Whether A-lines below the highest received number are missing."""
        return self.complete < self.horizon

    def receive(self, payload: bytes) -> None:
        """Process one ALINE payload; duplicates, other plans and numbers beyond the window are ignored."""
        if len(payload) < _HEAD.size:
            raise FrameError(f"{len(payload)} bytes where an A-line's head has {_HEAD.size}")
        head = ALineHead(*_HEAD.unpack_from(payload))
        if head.plan != self.plan:
            return
        if not head.fragment < head.fragments:
            raise FrameError(f"A-line {head.number}: impossible fragment")
        if head.fragments > 1:
            blob = self._joined(head, payload[_HEAD.size :])
            if blob is not None:
                self._keep(head.number, head.point, blob, head.encoding)
        elif not head.more:
            self._keep(head.number, head.point, payload[_HEAD.size :], head.encoding)
        else:
            self._keep_all(head, payload)
        self._advance()

    def _keep_all(self, head: ALineHead, payload: bytes) -> None:
        """Store several whole A-lines of one frame."""
        size, rest = divmod(len(payload) - _HEAD.size, head.more + 1)
        if rest or size <= 0:
            raise FrameError(f"{len(payload)} bytes are not {head.more + 1} equal A-lines")
        number, point = head.number, head.point
        first, last, lines = self.complete, self.durable + self._window, self._lines
        usual = head.encoding == Encoding.INT16 and not self._asked and size >= META_SIZE
        for end in range(_HEAD.size + size, len(payload) + 1, size):
            blob = payload[end - size : end]
            if usual and first <= number < last and number not in lines and is_complete(blob, size):
                lines[number] = point, blob  # without a call more than it needs
            else:
                self._keep(number, point, blob, head.encoding)
            number, point = number + 1, point + 1
        self.horizon = max(self.horizon, min(number, last) - 1)

    def _wanted(self, number: int) -> bool:
        """Record that A-line ``number`` was sent; return whether it is still missing here."""
        if number >= self.durable + self._window:
            return False
        if number > self.horizon:
            self.horizon = number
        if number < self.complete or number in self._lines:
            self.duplicates += 1
            return False
        return True

    def _keep(self, number: int, point: int, blob: bytes, encoding: int) -> None:
        """Store one whole A-line, unless it is a duplicate or damaged."""
        if not self._wanted(number):
            return
        try:
            self._lines[number] = point, parse_record(blob, encoding)
        except FrameError:
            self.damaged += 1
            return
        if self._asked:
            self._asked.pop(number, None)

    def _joined(self, head: ALineHead, piece: bytes) -> bytes | None:
        """Store one fragment; return the whole blob when all fragments are present."""
        if not self._wanted(head.number):
            return None
        parts = self._parts.setdefault(head.number, [None] * head.fragments)
        if len(parts) != head.fragments:
            parts = self._parts[head.number] = [None] * head.fragments
        parts[head.fragment] = piece
        whole = [part for part in parts if part is not None]
        if len(whole) < len(parts):
            return None
        del self._parts[head.number]
        return b"".join(whole)

    def _advance(self) -> None:
        """Advance the number of contiguously received A-lines."""
        limit, complete, lines = self.limit, self.complete, self._lines
        while complete in lines and complete < limit:
            complete += 1
        self.complete = complete
        if self.horizon < complete:
            self.horizon = complete

    def reset_pending(self) -> int:
        """Discard out-of-order A-lines, because they will be recorded again; return the next expected number."""
        self._lines = {number: line for number, line in self._lines.items() if number < self.complete}
        self._parts.clear()
        self._asked.clear()
        self.horizon = self.complete
        return self.complete

    def mark_sent(self, number: int) -> None:
        """Record that, according to STATUS, the device has sent all A-lines below ``number``."""
        self.horizon = max(self.horizon, min(number, self.limit))

    def pop_ready(self) -> ALineBatch:
        """Return the next A-lines in order that were not delivered yet, all of one length."""
        first, lines = self.delivered, self._lines
        points: list[int] = []
        records: list[bytes] = []
        for number in range(first, self.complete):
            point, record = lines[number]
            if records and len(record) != len(records[0]):
                break
            points.append(point)
            records.append(record)
            del lines[number]
        self.delivered = first + len(records)
        return ALineBatch(first, points, records)

    def acknowledge(self, durable: int) -> None:
        """Record that A-lines below ``durable`` are stored; only delivered ones can be."""
        self.durable = max(self.durable, min(durable, self.delivered))

    def missing(self, now: int) -> list[tuple[int, int]]:
        """Return (number, fragment) pairs to request again now, each at most once per repeat time."""
        wanted: list[tuple[int, int]] = []
        for number in range(self.complete, self.horizon):
            if number in self._lines or now - self._asked.get(number, -self._repeat) < self._repeat:
                continue
            if len(wanted) >= MAX_MISSING:
                break
            self._asked[number] = now
            self.repairs += 1
            parts = self._parts.get(number)
            if parts is None:
                wanted.append((number, ALL_FRAGMENTS))
            else:
                wanted += [(number, index) for index, part in enumerate(parts) if part is None]
        return wanted[:MAX_MISSING]
