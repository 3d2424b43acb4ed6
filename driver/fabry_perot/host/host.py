"""Host state machine without I/O: receives bytes and time, returns bytes."""

from __future__ import annotations

from fabry_perot.errors import FrameError
from fabry_perot.host.host_state import HostBody
from fabry_perot.host.link_states import HostState
from fabry_perot.host.message_handlers import HANDLERS
from fabry_perot.wire.constants import Type
from fabry_perot.wire.framing import Frame

_SESSIONLESS = frozenset({Type.HELLO_ACK, Type.BUSY, Type.ABORT_ACK})
"""Answered to by nonce, or by level and number, rather than by session."""
PROMPT_INTERVAL = 1000
"""Nothing is due within so many µs of a look at it, unless a frame comes in."""


class Host(HostBody):
    """Host side of the protocol; parameters as of :class:`~fabry_perot.host.host_state.HostBody`.

    Call :meth:`receive` with bytes as they come, :meth:`tick` every few ms, and send what :meth:`take_output` returns.
    Only whoever consumes the data may call :meth:`renew` and :meth:`acknowledge`: the laser's lease hangs on them.
    """

    _pulled_at = 0
    """Host time of the last :meth:`tick` before which bytes were sent."""

    def take_output(self) -> bytes:
        """Return the bytes to send now; after ``timing.keepalive`` without output, a zero byte as keep-alive."""
        data = super().take_output()
        if not data and self.hello is not None and self._polled_at - self._pulled_at >= self.timing.keepalive:
            data = b"\0"
        if data:
            self._pulled_at = self._polled_at
        return data

    def tick(self, now: int) -> None:
        """Send messages due at host time ``now``; fails if the device answers but the handshake takes too long."""
        super().tick(now)
        if self.greeting.done or self.phase in (HostState.CLOSED, HostState.LOST, HostState.HELLO):
            return
        self.greeting.done = self.capabilities is not None and self.status is not None
        if not self.greeting.done and (error := self.greeting.overdue(now)) is not None:
            self.fail(error)

    def receive(self, data: bytes, now: int) -> None:
        """Process bytes received at host time ``now``."""
        frames = self.deframer.feed(data)
        self.traffic.take(data)
        if not frames and 0 <= now - self._polled_at < PROMPT_INTERVAL:
            return
        for frame in frames:
            if not self._mine(frame) and frame.type not in _SESSIONLESS:
                self.foreign_frames += 1
            elif (handler := HANDLERS.get(frame.type)) is not None:
                try:
                    handler(self, frame, now)
                except (FrameError, ValueError):
                    self.deframer.counters.bad_length += 1
        self.tick(now)

    def _mine(self, frame: Frame) -> bool:
        hello = self.hello
        return hello is not None and frame.session == hello.session and frame.boot == hello.boot & 0xFF
