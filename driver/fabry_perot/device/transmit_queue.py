"""Transmit queue: control frames before data frames."""

from __future__ import annotations

from collections import deque

from fabry_perot.wire.constants import Type
from fabry_perot.wire.framing import FLAG_RETRANSMISSION, FLAG_URGENT, Frame, encode_frame

MAX_QUEUED = 64
"""Control frames kept; of more the last in line is dropped, since the host repeats what it got no answer to."""


class TransmitQueue:
    """Queue of control messages, and the sequence number of frames.

    Parameters
    ----------
    boot
        Low byte of the boot id, part of every frame.
    """

    def __init__(self, boot: int) -> None:
        self._boot = boot
        self._sequence = 0
        self._control: deque[tuple[Type, bytes, int]] = deque()
        self.session = 0

    def enqueue(self, kind: Type, payload: bytes, *, urgent: bool = False) -> None:
        """Queue a control message; an urgent message is placed first, and only once."""
        if urgent:
            item = (kind, payload, FLAG_URGENT)
            if item in self._control:
                return
            if len(self._control) >= MAX_QUEUED:
                self._control.pop()
            self._control.appendleft(item)
        elif len(self._control) < MAX_QUEUED:
            self._control.append((kind, payload, 0))

    def clear(self) -> None:
        """Discard queued messages at the start of a session."""
        self._control.clear()

    def next_control(self) -> bytes | None:
        """Return the next control frame's bytes, or ``None`` if the queue is empty."""
        if not self._control:
            return None
        return self.frame(*self._control.popleft())

    def frame(self, kind: Type, payload: bytes, flags: int = 0) -> bytes:
        """Return the encoded bytes of one frame, with the next sequence number."""
        self._sequence = (self._sequence + 1) & 0xFFFF
        return encode_frame(Frame(kind, flags, self._boot, self.session, self._sequence, payload))

    def aline(self, payload: bytes, again: bool) -> bytes:
        """Return the encoded bytes of one ALINE frame."""
        return self.frame(Type.ALINE, payload, FLAG_RETRANSMISSION if again else 0)
