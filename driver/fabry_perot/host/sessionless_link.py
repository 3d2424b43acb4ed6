"""Passive listener on a line: reads STATUS without a session, sends ABORT, and clears faults on request.

Sans-I/O: :meth:`Passive.receive` takes bytes, :meth:`Passive.pull` gives what is due; times are seconds of any
monotonic clock. STATUS, ABORT and ABORT_ACK are valid in every session, so nothing here disturbs the device's session;
HELLO is said only to a device that is silent, or when a request needs a session.
"""

from __future__ import annotations

import secrets
from contextlib import suppress
from dataclasses import dataclass

from fabry_perot.errors import FrameError, PortBusy, ProtocolMismatch, RequestRejected, ScannerError
from fabry_perot.host.aborts import Aborts
from fabry_perot.wire.constants import PROTOCOL, AbortLevel, Operation, Result, Type
from fabry_perot.wire.framing import FLAG_RETRANSMISSION, FLAG_URGENT, UART_PAYLOAD, Deframer, Frame, encode_frame
from fabry_perot.wire.messages import (
    REPLY_HEAD,
    REQUEST_HEAD,
    AbortAck,
    Hello,
    HelloAck,
    Status,
    pack,
    unpack,
    unpack_exact,
)
from fabry_perot.wire.states import DeviceState

SILENCE = 0.5
"""Seconds without a STATUS after which HELLO is said: a device that has just booted is silent until then."""
SETTLED = 0.04
"""A STATUS that comes sooner than so many s after opening, or after other such bytes, may have waited in a buffer."""
_HELLO_PERIOD, _SLOW_HELLO_PERIOD, _EAGER_HELLOS = 0.25, 1.0, 20
_ABORT_PERIOD, _REQUEST_PERIOD = 0.02, 0.5


@dataclass(slots=True, eq=False)
class Request:
    """Pending request of the passive listener.

    Parameters
    ----------
    operation
        Operation without parameters.
    done
        Whether it was answered.
    error
        Refusal of the device.
    """

    operation: Operation
    done: bool = False
    error: ScannerError | None = None
    _due: float = 0.0
    _tries: int = 0


class Passive:
    """Passive listener on a line: reads STATUS without a session, sends ABORT, and clears faults on request.

    Parameters
    ----------
    now
        Time of opening, in s.
    silence
        Seconds without a word of the device after which HELLO is said.
    """

    def __init__(self, now: float, silence: float = SILENCE) -> None:
        self._silence = silence
        self.deframer = Deframer()
        self.status: Status | None = None
        self.heard_at = now
        """Time of the last STATUS or answer, in s; before the first, the time of opening."""
        self.status_at = now
        self.failure: ScannerError | None = None
        """Present reason why the device cannot be asked: another host, another protocol version."""
        self.aborts = Aborts(secrets.randbits(32), _ABORT_PERIOD)
        self._received_at, self._settled = now, False
        self._hello_due = now
        self._hellos = 0
        self._nonce = secrets.randbits(32)
        self._hello: HelloAck | None = None
        self._wants_session = False
        self._request: Request | None = None
        self._sequence = 0

    def stop(self, now: float) -> None:
        """Start sending ABORT *laser off* until it is acknowledged."""
        self.aborts.start(AbortLevel.LASER_OFF, now)

    def ask(self, operation: Operation) -> Request:
        """Start a session, and then a request without parameters."""
        self._wants_session, self._hello, self._nonce = True, None, secrets.randbits(32)
        self._hello_due = 0.0
        self._request = Request(operation)
        return self._request

    def withdraw(self, request: Request) -> None:
        """Cancel a pending request."""
        if self._request is request:
            self._request, self._wants_session = None, False

    def receive(self, data: bytes, now: float) -> None:
        """Process received bytes."""
        if not data:
            return
        if now - self._received_at >= SETTLED:
            self._settled = True
        self._received_at = now
        for frame in self.deframer.feed(data):
            with suppress(FrameError, ValueError):
                self._take(frame, now)

    def _take(self, frame: Frame, now: float) -> None:
        if frame.type == Type.STATUS:
            self._take_status(unpack(Status, frame.payload), now)
        elif frame.type == Type.ABORT_ACK:
            if self.aborts.acknowledge(unpack(AbortAck, frame.payload)):
                self.heard_at = now
        elif frame.type == Type.HELLO_ACK:
            self._take_hello(unpack(HelloAck, frame.payload), now)
        elif frame.type == Type.RSP:
            self._take_reply(frame)
        elif frame.type == Type.BUSY:
            self.failure = PortBusy(f"another host is connected: {frame.payload.decode(errors='replace')}")

    def _take_status(self, status: Status, now: float) -> None:
        DeviceState(status.state)  # a state that is unknown is no STATUS
        self.aborts.take(status)
        if not self._settled and self.aborts.after is None:
            return
        self.status, self.status_at, self.heard_at, self.failure = status, now, now, None
        self._hellos = 0

    def _take_hello(self, ack: HelloAck, now: float) -> None:
        if ack.nonce != self._nonce:
            return
        self.heard_at = now
        if ack.version == 0:
            self.failure = ProtocolMismatch("the scanner speaks no protocol version of this driver")
            return
        self._hello, self._wants_session = ack, False

    def _take_reply(self, frame: Frame) -> None:
        _, operation, result, state = unpack_exact(REPLY_HEAD, frame.payload, tail=True)
        request, hello = self._request, self._hello
        if request is None or hello is None or frame.session != hello.session or operation != request.operation:
            return
        if result != Result.OK:
            reason = Result(result).name.lower().replace("_", "-")
            request.error = RequestRejected(request.operation.name, reason, DeviceState(state).name)
        request.done, self._request = True, None

    def pull(self, now: float) -> bytes:
        """Return the bytes to send now."""
        frames = []
        if (abort := self.aborts.due(now)) is not None:
            frames.append(self._frame(Type.ABORT, abort, FLAG_URGENT))
        silent = now - max(self.heard_at, self.status_at) > self._silence
        if (self._wants_session or silent) and now >= self._hello_due:
            self._hellos += 1
            eager = self._wants_session or self._hellos < _EAGER_HELLOS
            self._hello_due = now + (_HELLO_PERIOD if eager else _SLOW_HELLO_PERIOD)
            frames.append(self._frame(Type.HELLO, pack(Hello(PROTOCOL, PROTOCOL, UART_PAYLOAD, self._nonce))))
        request = self._request
        if request is not None and self._hello is not None and now >= request._due:
            request._due, request._tries = now + _REQUEST_PERIOD, request._tries + 1
            flags = FLAG_RETRANSMISSION if request._tries > 1 else 0
            frames.append(self._frame(Type.REQ, REQUEST_HEAD.pack(1, request.operation), flags))
        return b"".join(frames)

    def next_due(self, now: float) -> float:
        """Return the seconds until :meth:`pull` may have something to send."""
        due = max(self.heard_at, self.status_at) + self._silence
        if self._wants_session or now > due:
            due = self._hello_due
        if (abort := self.aborts.due_at()) is not None:
            due = min(due, abort)
        if self._request is not None and self._hello is not None:
            due = min(due, self._request._due)
        return max(0.0, due - now)

    def _frame(self, kind: Type, payload: bytes, flags: int = 0) -> bytes:
        self._sequence = (self._sequence + 1) & 0xFFFF
        hello = self._hello
        session, boot = (hello.session, hello.boot & 0xFF) if hello is not None else (0, 0)
        return encode_frame(Frame(kind, flags, boot, session, self._sequence, payload))
