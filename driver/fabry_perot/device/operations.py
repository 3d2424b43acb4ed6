"""The requests a host can make (REQ), one function each, in one table."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from fabry_perot.codes import Operation, Result, Type
from fabry_perot.instrument import Acquisition
from fabry_perot.messages import ALineGone, pack
from fabry_perot.states import RUNNING, DeviceState, Event

if TYPE_CHECKING:
    from fabry_perot.device.core import Device

Body = dict[str, Any]
Outcome = tuple[Result, Body]


def carry_out(device: Device, operation: int, body: Body) -> Outcome:
    """Carry out one request on ``device`` and return its outcome."""
    try:
        function = _TABLE[Operation(operation)]
    except (ValueError, KeyError):
        return Result.UNKNOWN_OPERATION, {}
    try:
        return function(device, body)
    except (KeyError, TypeError, ValueError):
        return Result.MALFORMED, {}


def _event(device: Device, event: Event) -> Outcome:
    return (Result.OK if device.step(event) else Result.WRONG_STATE), {}


def _get(device: Device, body: Body) -> Outcome:
    return Result.OK, device.statistics()


def _plan_new(device: Device, body: Body) -> Outcome:
    plan, length, purge = int(body["plan"]), int(body["length"]), bool(body.get("purge", False))
    acquisition = Acquisition(int(body["samples"]), int(body["interval_ps"]), int(body["pulse_rate_mhz"]))
    bounds = device.limits
    for value, name in (
        (acquisition.samples, "samples"),
        (acquisition.interval_ps, "interval_ps"),
        (acquisition.pulse_rate_mhz, "pulse_rate_mhz"),
    ):
        if not bounds[name][0] <= value <= bounds[name][1]:
            return Result.OUT_OF_RANGE, {"field": name}
    if not (0 < plan <= 0xFFFFFFFF and 0 < length <= 0xFFFFFFFF):
        return Result.OUT_OF_RANGE, {"field": "length"}
    if device.ring.fill and not purge:
        return Result.RING_NOT_EMPTY, {}
    if not device.step(Event.PLAN_NEW):
        return Result.WRONG_STATE, {}
    old, first = device.ring.plan, device.ring.acknowledged
    purged = device.ring.clear(plan)
    if purged:
        device.outbox.put(Type.ALINE_GONE, pack(ALineGone(old, first, purged, 1)))
    device.plan.begin(plan, length)
    device.begin(acquisition)
    return Result.OK, {}


def _arm(device: Device, body: Body) -> Outcome:
    if not device.step(Event.ARM):
        return Result.WRONG_STATE, {}
    return Result.OK, {"token": device.new_token()}


def _start(device: Device, body: Body) -> Outcome:
    token, echo, ttl = int(body["token"]), int(body["echo"]), int(body["ttl"])
    if device.state is not DeviceState.ARMED:
        return Result.WRONG_STATE, {}
    if token != device.token:
        return Result.BAD_TOKEN, {}
    device.lease.clear(device.now)  # what a scan before this one was granted is not this one's
    if not device.lease.renew(echo, ttl, device.now):
        return Result.NO_LEASE, {}
    return _event(device, Event.START)


def _park(device: Device, body: Body) -> Outcome:
    if device.state in RUNNING or device.state is DeviceState.ARMED:
        return Result.WRONG_STATE, {}
    device.instrument.park()
    return Result.OK, {}


def _release(device: Device, body: Body) -> Outcome:
    return _event(device, Event.RELEASE if device.plan.loaded else Event.RELEASE_WITHOUT_PLAN)


def _unsupported(device: Device, body: Body) -> Outcome:
    return Result.NOT_SUPPORTED, {}


_TABLE: dict[Operation, Callable[[Device, Body], Outcome]] = {
    Operation.GET: _get,
    Operation.SET: _unsupported,
    Operation.PLAN_NEW: _plan_new,
    Operation.ARM: _arm,
    Operation.START: _start,
    Operation.PAUSE: lambda device, body: _event(device, Event.PAUSE),
    Operation.PARK: _park,
    Operation.TUNE_SCAN: _unsupported,
    Operation.DISARM: lambda device, body: _event(device, Event.DISARM),
    Operation.CLEAR_FAULT: lambda device, body: _event(device, Event.CLEAR_FAULT),
    Operation.RELEASE: _release,
}
