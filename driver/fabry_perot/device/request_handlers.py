"""Handlers of the requests (REQ) of a host: one function per operation, in one table."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fabry_perot import fault_codes
from fabry_perot.device.device_state import DeviceBody
from fabry_perot.hardware.instrument import InstrumentError, PlanSampling
from fabry_perot.wire.constants import (
    INTERLOCK_CLOSED,
    KEY_ON,
    LASER_EMITTING,
    MAX_GROUP,
    SHUTTER_OPEN,
    Operation,
    Result,
    Type,
)
from fabry_perot.wire.messages import ALineGone, pack
from fabry_perot.wire.states import LATCHED_STATES, RUNNING, DeviceState, Event

MAX_STEPS = 256
"""Longest wavelength sweep."""
LONGEST_TEXT = 120
"""Longest text of a fault, in characters."""
_IDLE_STATES = frozenset(DeviceState) - RUNNING - LATCHED_STATES - {DeviceState.ARMED}
"""States in which something may be moved, tuned or changed."""
Body = dict[str, Any]
OperationResult = tuple[Result, Body]


def execute(device: DeviceBody, operation: int, body: Body) -> OperationResult | None:
    """Execute a request on ``device`` and return its outcome; ``None`` if it has started a sweep."""
    try:
        function = _TABLE[Operation(operation)]
    except (ValueError, KeyError):
        return Result.UNKNOWN_OPERATION, {}
    try:
        return function(device, body)
    except InstrumentError as error:
        device.raise_fault(error.fault, str(error))
        return Result.HARDWARE_FAULT, {}
    except (KeyError, TypeError, ValueError):
        return Result.MALFORMED, {}


def _event(device: DeviceBody, event: Event) -> OperationResult:
    return (Result.OK if device.try_transition(event) else Result.WRONG_STATE), {}


def _get(device: DeviceBody, body: Body) -> OperationResult:
    answer = {**device.statistics(), "fault_text": device.fault_text[:LONGEST_TEXT]}
    try:
        answer |= device.instrument.parameters()
    except InstrumentError:
        if device.state not in LATCHED_STATES:  # then it is latched now, and the next GET tells of it
            raise
    return Result.OK, answer


def _plan_new(device: DeviceBody, body: Body) -> OperationResult:
    plan, length, purge = int(body["plan"]), int(body["length"]), bool(body.get("purge", False))
    start, encoding, group = int(body.get("start", 0)), int(body.get("encoding", 0)), int(body.get("group", 1))
    beams = int(body.get("beams", 1))
    sampling = PlanSampling(int(body["samples"]), int(body["interval_ps"]), int(body["pulse_rate_mhz"]), beams)
    bounds = device.limits
    for value, name in (
        (sampling.samples, "samples"),
        (sampling.interval_ps, "interval_ps"),
        (sampling.pulse_rate_mhz, "pulse_rate_mhz"),
    ):
        if not bounds[name][0] <= value <= bounds[name][1]:
            return Result.OUT_OF_RANGE, {"field": name}
    for value, name, low, high in (
        (plan, "plan", 1, 0xFFFFFFFF),
        (length, "length", 1, 0xFFFFFFFF),
        (start, "start", 0, length - 1),
        (beams, "beams", 1, min(bounds["beams"], device.ring.capacity, device.plan.capacity)),
    ):
        if not low <= value <= high:
            return Result.OUT_OF_RANGE, {"field": name}
    if length % beams:
        return Result.OUT_OF_RANGE, {"field": "length"}
    if encoding not in bounds["encodings"]:
        return Result.OUT_OF_RANGE, {"field": "encoding"}
    if not 1 <= group <= MAX_GROUP:
        return Result.OUT_OF_RANGE, {"field": "group"}
    if device.ring.used and not purge:
        return Result.RING_NOT_EMPTY, {}
    if not device.try_transition(Event.PLAN_NEW):
        return Result.WRONG_STATE, {}
    old, first = device.ring.plan, device.ring.acknowledged
    purged = device.ring.clear(plan, start)
    device.ring.group = group
    if purged:
        device.outbox.enqueue(Type.ALINE_GONE, pack(ALineGone(old, first, purged, 1)))
    device.plan.reset(plan, length, start)
    device.begin(sampling, encoding)
    return Result.OK, {}


def _arm(device: DeviceBody, body: Body) -> OperationResult:
    if device.job is not None or not device.try_transition(Event.ARM):
        return Result.WRONG_STATE, {}
    return Result.OK, {"token": device.issue_arm_token()}


def _start(device: DeviceBody, body: Body) -> OperationResult:
    token, echo, ttl = int(body["token"]), int(body["echo"]), int(body["ttl"])
    if device.state is not DeviceState.ARMED:
        return Result.WRONG_STATE, {}
    if token != device.token:
        return Result.BAD_TOKEN, {}
    device.lease.clear(device.now)  # what a scan before this one was granted is not this one's
    if not device.lease.renew(echo, ttl, device.now):
        return Result.NO_LEASE, {}
    if not device.check_safety():
        return Result.HARDWARE_FAULT, {}
    before = device.instrument.shots()
    device.instrument.open()
    device.transition(Event.START)
    device.scan.begin()
    return Result.OK, {"laser_shots": before}


def _park(device: DeviceBody, body: Body) -> OperationResult:
    if device.state not in _IDLE_STATES or device.job is not None:
        return Result.WRONG_STATE, {}
    device.close()
    device.instrument.park(device.now)
    return Result.OK, {}


def _release(device: DeviceBody, body: Body) -> OperationResult:
    return _event(device, Event.RELEASE if device.plan.loaded else Event.RELEASE_WITHOUT_PLAN)


def _cause_stands(device: DeviceBody) -> bool:
    """Return whether the cause of a latched fault persists, so that the fault cannot be cleared."""
    bits = device.hardware_bits()
    cause = fault_codes.standing(
        device.fault,
        interlock_closed=bool(bits & INTERLOCK_CLOSED),
        key_on=bool(bits & KEY_ON),
        light=bool(bits & (SHUTTER_OPEN | LASER_EMITTING)),
    )
    return device.state in LATCHED_STATES and bool(cause)


def _clear_fault(device: DeviceBody, body: Body) -> OperationResult:
    if _cause_stands(device):
        device.close()  # again: it may be the shutter that stands
        if _cause_stands(device):
            return Result.WRONG_STATE, {}
    return _event(device, Event.CLEAR_FAULT)


def _set(device: DeviceBody, body: Body) -> OperationResult:
    if device.state not in _IDLE_STATES or device.job is not None:
        return Result.WRONG_STATE, {}
    allowed = device.limits.get("parameters", {})
    values = {str(name): int(value) for name, value in body.items()}
    for name, value in values.items():
        if name not in allowed:
            return Result.NOT_SUPPORTED, {"field": name}
        if not allowed[name][0] <= value <= allowed[name][1]:
            return Result.OUT_OF_RANGE, {"field": name}
    for name, value in values.items():
        device.instrument.configure(name, value)
    return Result.OK, device.instrument.parameters()


def _tune_scan(device: DeviceBody, body: Body) -> OperationResult | None:
    bounds, steps = device.limits, int(body["steps"])
    if device.state not in _IDLE_STATES or device.job is not None:
        return Result.WRONG_STATE, {}
    if not bounds.get("tuning_us"):
        return Result.NOT_SUPPORTED, {}
    place = {name: int(body[name]) for name in ("x", "y")}
    sweep = {name: int(body[name]) for name in ("from_pm", "to_pm")}
    for axis, value in place.items():
        if not bounds[f"{axis}_nm"][0] <= value <= bounds[f"{axis}_nm"][1]:
            return Result.OUT_OF_RANGE, {"field": axis}
    low, high = bounds["wavelength_pm"]
    if not low <= sweep["from_pm"] <= high:
        return Result.OUT_OF_RANGE, {"field": "from_pm"}
    if not sweep["from_pm"] < sweep["to_pm"] <= high:
        return Result.OUT_OF_RANGE, {"field": "to_pm"}
    if not 2 <= steps <= MAX_STEPS:
        return Result.OUT_OF_RANGE, {"field": "steps"}
    wavelengths = np.linspace(sweep["from_pm"], sweep["to_pm"], steps).round().astype(np.int64)
    device.instrument.sweep(place["x"], place["y"], wavelengths, device.now)
    return None


_TABLE: dict[Operation, Callable[[DeviceBody, Body], OperationResult | None]] = {
    Operation.GET: _get,
    Operation.SET: _set,
    Operation.PLAN_NEW: _plan_new,
    Operation.ARM: _arm,
    Operation.START: _start,
    Operation.PAUSE: lambda device, body: _event(device, Event.PAUSE),
    Operation.PARK: _park,
    Operation.TUNE_SCAN: _tune_scan,
    Operation.DISARM: lambda device, body: _event(device, Event.DISARM),
    Operation.CLEAR_FAULT: _clear_fault,
    Operation.RELEASE: _release,
}
