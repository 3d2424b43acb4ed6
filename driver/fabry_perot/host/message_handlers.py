"""Message handlers of the host: one function per message, in one table."""

from __future__ import annotations

from collections.abc import Callable

from fabry_perot.errors import DeviceRestarted, PortBusy
from fabry_perot.host.capabilities import Capabilities
from fabry_perot.host.host_state import HostBody
from fabry_perot.host.link_states import HostState
from fabry_perot.wire.constants import PROTOCOL, Operation, Type
from fabry_perot.wire.framing import Frame, crc32c
from fabry_perot.wire.messages import (
    CAPS_HEAD,
    REPLY_HEAD,
    AbortAck,
    ALineGone,
    Fault,
    HelloAck,
    PlanStatus,
    Status,
    pack,
    unpack,
    unpack_body,
    unpack_exact,
)
from fabry_perot.wire.states import DeviceState


def _hello_ack(host: HostBody, frame: Frame, now: int) -> None:
    ack = unpack(HelloAck, frame.payload)
    if ack.nonce != host.nonce:
        return
    host.heard_at = now
    if ack.version != PROTOCOL:
        host.other_version(ack.version)
    elif host.hello is not None and ack.boot != host.hello.boot and not host.tolerant:
        host.fail(DeviceRestarted())
    else:
        host.greeting.progress(now)
        _take_session(host, ack)


def _take_session(host: HostBody, ack: HelloAck) -> None:
    before, host.device_state = host.hello, DeviceState(ack.state)
    if before is not None and (before.boot, before.session) != (ack.boot, ack.session):
        host.session_renewed(ack)
    host.hello = ack
    if before is None or before.caps_crc != ack.caps_crc:
        host.phase, host.caps_buffer = HostState.CONFIG, b""
    elif host.phase is HostState.HELLO:
        known = host.capabilities is not None
        host.phase = (HostState.STREAMING if host.assembly else HostState.CONNECTED) if known else HostState.CONFIG


def _caps_piece(host: HostBody, frame: Frame, now: int) -> None:
    offset, size = unpack_exact(CAPS_HEAD, frame.payload, tail=True)
    if host.phase is not HostState.CONFIG or host.hello is None or offset != len(host.caps_buffer):
        return
    host.greeting.progress(now)
    host.caps_buffer += frame.payload[CAPS_HEAD.size :]
    host.request_capabilities(now)
    if len(host.caps_buffer) >= size:
        data, host.caps_buffer = host.caps_buffer, b""
        if crc32c(data) == host.hello.caps_crc:
            host.capabilities = Capabilities.from_map(unpack_body(data))
            host.clock_rate = host.capabilities.clock_rate
            host.phase = HostState.CONNECTED


def _reply(host: HostBody, frame: Frame, now: int) -> None:
    number, _operation, result, state = unpack_exact(REPLY_HEAD, frame.payload, tail=True)
    body = unpack_body(frame.payload[REPLY_HEAD.size :])
    host.heard_at = now
    call = host.calls.answer(number, result, DeviceState(state), body)
    if call is None:
        return
    host.device_state = DeviceState(state)
    if call.error is not None:
        return
    if call.operation is Operation.PLAN_NEW and host.uploader is not None and host.assembly is None:
        host.receive_from(host.uploader.plan.uid, host.uploader.start)
    elif call.operation is Operation.ARM:
        host.phase = HostState.ARMING
    elif call.operation is Operation.START:
        host.phase = HostState.STREAMING
        host.contact = (now, host.status.device_time if host.status else 0)


def _plan_status(host: HostBody, frame: Frame, now: int) -> None:
    host.plan_status = unpack(PlanStatus, frame.payload)
    if host.uploader is not None and host.assembly is not None:
        host.uploader.receive(host.plan_status, now)


def _aline(host: HostBody, frame: Frame, now: int) -> None:
    if host.assembly is not None:
        host.assembly.receive(frame.payload)


def _aline_gone(host: HostBody, frame: Frame, now: int) -> None:
    host.gone += unpack(ALineGone, frame.payload).lines


def _status(host: HostBody, frame: Frame, now: int) -> None:
    status = unpack(Status, frame.payload)
    host.status, host.heard_at = status, now
    host.device_state = DeviceState(status.state)
    host.aborts.take(status)
    if host.device_state is DeviceState.FAULT:
        host.fault = status.fault
    if host.assembly is not None and status.plan == host.assembly.plan:
        host.assembly.mark_sent(status.sent)


def _abort_ack(host: HostBody, frame: Frame, now: int) -> None:
    host.abort_acknowledged(unpack(AbortAck, frame.payload))


def _fault(host: HostBody, frame: Frame, now: int) -> None:
    fault = unpack(Fault, frame.payload)
    if host.device_state is not DeviceState.ESTOP:
        host.device_state = DeviceState.FAULT
    host.fault = fault.code
    host.send(Type.FAULT_ACK, pack(fault))


def _busy(host: HostBody, frame: Frame, now: int) -> None:
    if host.hello is None:  # later it is our own old connection, of which the far end does not know yet that it is gone
        host.fail(PortBusy(f"another host is connected: {frame.payload.decode(errors='replace')}"))


HANDLERS: dict[int, Callable[[HostBody, Frame, int], None]] = {
    Type.HELLO_ACK: _hello_ack,
    Type.CAPS_PIECE: _caps_piece,
    Type.RSP: _reply,
    Type.PLAN_STATUS: _plan_status,
    Type.ALINE: _aline,
    Type.ALINE_GONE: _aline_gone,
    Type.STATUS: _status,
    Type.ABORT_ACK: _abort_ack,
    Type.FAULT: _fault,
    Type.BUSY: _busy,
}
