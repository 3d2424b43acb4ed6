"""Transport decorator that prints every frame in both directions."""

from __future__ import annotations

import logging
import struct
import time
from collections.abc import Callable
from typing import Any

from fabry_perot import fault_codes
from fabry_perot.errors import FrameError
from fabry_perot.host.transport import Transport
from fabry_perot.wire.constants import Operation, Result, Type
from fabry_perot.wire.framing import Deframer, Frame
from fabry_perot.wire.messages import (
    CAPS_HEAD,
    CAPS_REQUEST,
    LAYOUT,
    PLAN_HEAD,
    REPLY_HEAD,
    REQUEST_HEAD,
    Abort,
    AbortAck,
    ALineAck,
    ALineGone,
    ALineHead,
    Fault,
    Hello,
    HelloAck,
    Lease,
    PlanStatus,
    Status,
    unpack,
    unpack_body,
    unpack_exact,
)

_log = logging.getLogger(__name__)
_MESSAGES: dict[int, type[Any]] = {
    Type.HELLO: Hello,
    Type.HELLO_ACK: HelloAck,
    Type.PLAN_STATUS: PlanStatus,
    Type.ALINE: ALineHead,
    Type.ALINE_ACK: ALineAck,
    Type.ALINE_GONE: ALineGone,
    Type.STATUS: Status,
    Type.LEASE: Lease,
    Type.ABORT: Abort,
    Type.ABORT_ACK: AbortAck,
    Type.FAULT: Fault,
    Type.FAULT_ACK: Fault,
}
_NUMBERS: dict[int, tuple[struct.Struct, tuple[str, ...]]] = {
    Type.CAPS: (CAPS_REQUEST, ("offset",)),
    Type.CAPS_PIECE: (CAPS_HEAD, ("offset", "size")),
    Type.PLAN_DATA: (PLAN_HEAD, ("plan", "first", "count")),
}


class TracingTransport:
    """Transport decorator that passes every sent and received frame, as text, to a callback.

    Parameters
    ----------
    transport
        The port.
    show
        Called with one line a frame: seconds since the tap was opened, ``>`` to or ``<`` from the device, the message;
        after it has raised an error it is not called again.
    """

    def __init__(self, transport: Transport, show: Callable[[str], None]) -> None:
        self._transport = transport
        self.baudrate: int | None = getattr(transport, "baudrate", None)
        self._show: Callable[[str], None] | None = show
        self._up, self._down = Deframer(), Deframer()
        self._opened = time.monotonic()

    def read(self) -> bytes:
        """Return received bytes, and pass their frames to the callback; raises LinkLost."""
        data = self._transport.read()
        self._look("<", self._down, data)
        return data

    def write(self, data: bytes) -> None:
        """Send all of ``data``, and pass its frames to the callback; raises LinkLost."""
        self._transport.write(data)
        self._look(">", self._up, data)

    def close(self) -> None:
        """Close the wrapped transport."""
        self._transport.close()

    def _look(self, way: str, deframer: Deframer, data: bytes) -> None:
        """Pass the frames in ``data`` to the callback; a failed callback does not interrupt the traffic."""
        if self._show is None:
            return
        try:
            self._tell(self._show, way, deframer, data)
        except Exception as error:
            self._show = None
            _log.warning("the frames are not shown any more: %r", error)

    def _tell(self, show: Callable[[str], None], way: str, deframer: Deframer, data: bytes) -> None:
        bad = deframer.counters.bad
        frames = deframer.feed(data) if data else []
        at = time.monotonic() - self._opened
        for frame in frames:
            show(f"{at:10.4f} {way} {format_frame(frame)}")
        if deframer.counters.bad > bad:
            show(f"{at:10.4f} {way} {deframer.counters.bad - bad} damaged")


def format_frame(frame: Frame) -> str:
    """Return a frame as text: type, session, size, and the message's fields in the protocol's units."""
    kind = Type(frame.type).name if frame.type in set(Type) else f"unknown {frame.type:02X}"
    head = f"{kind:<11} session {frame.session:04x} {len(frame.payload):5d} bytes"
    try:
        fields = _fields(frame)
    except (FrameError, ValueError) as error:
        fields = {"damaged": error}
    return " ".join([head, *(f"{name}={value}" for name, value in fields.items())])


def _fields(frame: Frame) -> dict[str, Any]:
    payload = frame.payload
    if frame.type in _MESSAGES:
        kind = _MESSAGES[frame.type]
        message: dict[str, Any] = unpack(kind, payload, tail=True)._asdict()
        if frame.type == Type.FAULT:
            message["name"] = fault_codes.by_code(message["code"]).name
        rest = len(payload) - LAYOUT[kind].size
        return message | ({"more_bytes": rest} if rest else {})
    if frame.type in _NUMBERS:
        layout, names = _NUMBERS[frame.type]
        return dict(zip(names, unpack_exact(layout, payload, tail=True), strict=True))
    if frame.type == Type.REQ:
        number, operation = unpack_exact(REQUEST_HEAD, payload, tail=True)
        return {"request": number, "operation": Operation(operation).name} | unpack_body(payload[REQUEST_HEAD.size :])
    if frame.type == Type.RSP:
        number, operation, result, _ = unpack_exact(REPLY_HEAD, payload, tail=True)
        answer = {"request": number, "operation": Operation(operation).name, "result": Result(result).name}
        return answer | unpack_body(payload[REPLY_HEAD.size :])
    return {"text": payload.decode(errors="replace")} if frame.type == Type.BUSY else {}
