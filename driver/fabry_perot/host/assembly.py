"""Putting A-lines together from fragments that may be lost, doubled or late."""

from __future__ import annotations

from fabry_perot.aline import ALine
from fabry_perot.codes import ALL_FRAGMENTS, MAX_MISSING
from fabry_perot.errors import FrameError
from fabry_perot.messages import ALineHead, unpack

_HEAD = 16


class Assembly:
    """A-lines in order of their number, each exactly once.

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
        self._lines: dict[int, ALine] = {}
        self._parts: dict[int, list[bytes | None]] = {}
        self._asked: dict[int, int] = {}

    @property
    def limit(self) -> int:
        """The device may send A-lines below this number."""
        return self.durable + self._window

    @property
    def gaps(self) -> bool:
        """Whether A-lines below the horizon are missing."""
        return self.complete < self.horizon

    def receive(self, payload: bytes) -> None:
        """Take one ALINE payload; anything of another plan, doubled or beyond the window is ignored."""
        head = unpack(ALineHead, payload, tail=True)
        number = head.number
        if head.plan != self.plan or number >= self.limit:
            return
        if not head.fragment < head.fragments:
            raise FrameError(f"A-line {number}: impossible fragment")
        self.horizon = max(self.horizon, number)
        if number < self.complete or number in self._lines:
            self.duplicates += 1
            return
        if head.fragments == 1:
            self._finish(head, payload[_HEAD:])
            return
        parts = self._parts.setdefault(number, [None] * head.fragments)
        if len(parts) != head.fragments:
            parts = self._parts[number] = [None] * head.fragments
        parts[head.fragment] = payload[_HEAD:]
        whole = [part for part in parts if part is not None]
        if len(whole) == len(parts):
            self._finish(head, b"".join(whole))

    def _finish(self, head: ALineHead, blob: bytes) -> None:
        number = head.number
        self._parts.pop(number, None)
        try:
            self._lines[number] = ALine.from_blob(number, head.point, blob, head.encoding)
        except FrameError:
            self.damaged += 1
            return
        self._asked.pop(number, None)
        while self.complete in self._lines and self.complete < self.limit:
            self.complete += 1
        if self.horizon < self.complete:
            self.horizon = self.complete

    def restart(self) -> int:
        """Forget what is not in order yet, because it will be recorded anew; return the first number wanted."""
        self._lines = {number: line for number, line in self._lines.items() if number < self.complete}
        self._parts.clear()
        self._asked.clear()
        self.horizon = self.complete
        return self.complete

    def sent(self, number: int) -> None:
        """Learn from STATUS that the device has sent everything below ``number``."""
        self.horizon = max(self.horizon, min(number, self.limit))

    def take(self) -> list[ALine]:
        """Return the A-lines that are next in order and not yet delivered."""
        lines = [self._lines.pop(number) for number in range(self.delivered, self.complete)]
        self.delivered = self.complete
        return lines

    def acknowledge(self, durable: int) -> None:
        """Learn that A-lines below ``durable`` are stored; only delivered ones can be."""
        self.durable = max(self.durable, min(durable, self.delivered))

    def missing(self, now: int) -> list[tuple[int, int]]:
        """Return (number, fragment) to ask for now, each at most once per repeat time."""
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
