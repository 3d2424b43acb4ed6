"""Message handlers of the device: one function per message, in one table."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from fabry_perot.device.device_state import DeviceBody
from fabry_perot.device.request_handlers import OperationResult, execute
from fabry_perot.errors import FrameError
from fabry_perot.wire.constants import FLAG_GATE, PROTOCOL, AbortLevel, Result, Type
from fabry_perot.wire.framing import Frame
from fabry_perot.wire.messages import (
    CAPS_HEAD,
    CAPS_REQUEST,
    MISSING,
    PLAN_HEAD,
    POINT,
    REQUEST_HEAD,
    Abort,
    AbortAck,
    ALineAck,
    Fault,
    Hello,
    HelloAck,
    Lease,
    pack,
    unpack,
    unpack_body,
    unpack_exact,
)
from fabry_perot.wire.states import DeviceState, Event, HoldCause

MIN_PAYLOAD = 64
"""Largest payload of a line is never agreed to be less, in bytes."""


def _hello(device: DeviceBody, frame: Frame) -> None:
    hello = unpack(Hello, frame.payload)
    version = PROTOCOL if hello.oldest <= PROTOCOL <= hello.newest else 0
    if version and hello.nonce != device.nonce:
        device.new_session(hello.nonce)
        device.line_payload = max(MIN_PAYLOAD, min(device.max_payload, hello.max_payload))
    ring, plan = device.ring, device.plan
    answer = HelloAck(
        nonce=hello.nonce,
        boot=device.boot,
        session=device.outbox.session,
        version=version,
        reset_cause=device.reset_cause,
        state=device.state,
        lanes=1,
        max_payload=device.line_payload,
        ring=ring.capacity,
        caps_size=len(device.caps),
        caps_crc=device.caps_crc,
        plan=plan.plan,
        length=plan.length,
        position=plan.position,
        produced=ring.produced,
        acknowledged=ring.acknowledged,
        device_time=device.now,
    )
    device.outbox.enqueue(Type.HELLO_ACK, pack(answer))


def _caps(device: DeviceBody, frame: Frame) -> None:
    (offset,) = unpack_exact(CAPS_REQUEST, frame.payload)
    room = device.line_payload - CAPS_HEAD.size
    piece = device.caps[offset : offset + room]
    device.outbox.enqueue(Type.CAPS_PIECE, CAPS_HEAD.pack(offset, len(device.caps)) + piece)


def _request(device: DeviceBody, frame: Frame) -> None:
    number, operation = unpack_exact(REQUEST_HEAD, frame.payload, tail=True)
    if number == device.job:
        return  # under way: its answer comes when it is over
    known = device.replies.find(number)
    if known is not None:
        device.outbox.enqueue(Type.RSP, known)
    elif device.replies.stale(number):
        device.reply(number, operation, Result.STALE_REQUEST, {})
    else:
        outcome: OperationResult | None = (Result.MALFORMED, {})
        with suppress(FrameError):
            outcome = execute(device, operation, unpack_body(frame.payload[REQUEST_HEAD.size :]))
        if outcome is None:
            device.job = number
        else:
            device.reply(number, operation, *outcome)


def _plan_data(device: DeviceBody, frame: Frame) -> None:
    plan, first, count = unpack_exact(PLAN_HEAD, frame.payload, tail=True)
    data = frame.payload[PLAN_HEAD.size :]
    if len(data) != count * POINT.itemsize:
        raise FrameError("PLAN_DATA's count and length differ")
    device.plan_status_due = True
    if plan != device.plan.plan or not device.plan.length:
        return
    points = np.frombuffer(data, POINT)
    if not _allowed(device, points):
        device.plan_refused = True
        return
    device.plan.accept(first, points)
    if device.plan.loaded and device.state is DeviceState.LINKED:
        device.try_transition(Event.PLAN_LOADED)


def _allowed(device: DeviceBody, points: np.ndarray[tuple[int], np.dtype[np.void]]) -> bool:
    for name in ("x", "y"):
        low, high = device.limits[f"{name}_nm"]
        if not np.all((points[name] >= low) & (points[name] <= high)):
            return False
    if np.any(points["flags"] & FLAG_GATE) and not device.limits.get("gate", False):
        return False
    low, high = device.limits["wavelength_pm"]
    bias = points["wavelength"]
    if not np.all((bias == 0) | ((bias >= low) & (bias <= high))):
        return False
    low, high = device.limits["averages"]
    return bool(np.all((points["averages"] >= low) & (points["averages"] <= high)))


def _aline_ack(device: DeviceBody, frame: Frame) -> None:
    ack = unpack(ALineAck, frame.payload, tail=True)
    tail = frame.payload[12:]
    if len(tail) % MISSING.size:
        raise FrameError("ALINE_ACK's missing list is cut short")
    if ack.plan == device.ring.plan:
        device.ring.acknowledge(ack.durable, ack.limit, list(MISSING.iter_unpack(tail)))


def _lease(device: DeviceBody, frame: Frame) -> None:
    lease = unpack(Lease, frame.payload)
    if lease.boot == device.boot:
        device.lease.renew(lease.echo, lease.ttl, device.now)


def _abort(device: DeviceBody, frame: Frame) -> None:
    abort = unpack(Abort, frame.payload)
    try:
        level = AbortLevel(abort.level)
    except ValueError:
        level = AbortLevel.LASER_OFF
    events = {
        AbortLevel.PAUSE: Event.PAUSE,
        AbortLevel.LASER_OFF: Event.LASER_OFF,
        AbortLevel.EMERGENCY_STOP: Event.EMERGENCY_STOP,
    }
    if not device.try_transition(events[level]) and level is not AbortLevel.PAUSE:
        _keep_held(device)
    ack = AbortAck(abort.level, abort.number, device.state)
    device.outbox.enqueue(Type.ABORT_ACK, pack(ack), urgent=True)


def _keep_held(device: DeviceBody) -> None:
    """Require a person to resume an interrupted scan, because laser off was requested during the interruption."""
    if device.state is DeviceState.SAFE_HOLD and device.cause is not HoldCause.INTERLOCK:
        device.cause, device._status_due = HoldCause.REQUEST, True


def _fault_ack(device: DeviceBody, frame: Frame) -> None:
    device.acknowledge_fault(unpack(Fault, frame.payload).number)


HANDLERS: dict[int, Callable[[DeviceBody, Frame], None]] = {
    Type.HELLO: _hello,
    Type.CAPS: _caps,
    Type.REQ: _request,
    Type.PLAN_DATA: _plan_data,
    Type.ALINE_ACK: _aline_ack,
    Type.LEASE: _lease,
    Type.ABORT: _abort,
    Type.FAULT_ACK: _fault_ack,
}
