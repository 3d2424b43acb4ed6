"""What the hardware is told, and what STATUS says of it: the shutter, the laser, key and interlock."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from functools import partial

import pytest
from driver_bench import Bench, NotReached

from fabry_perot.errors import RequestRejected, ScannerError
from fabry_perot.host import Host
from fabry_perot.wire.constants import (
    FAULT_INTERLOCK,
    FAULT_KEY,
    FAULT_SHUTTER,
    INTERLOCK_CLOSED,
    KEY_ON,
    LASER_EMITTING,
    SHUTTER_OPEN,
    AbortLevel,
    Operation,
)
from fabry_perot.wire.states import RUNNING, TRANSITIONS, DeviceState, Event

S, E = DeviceState, Event
INTO = {S.SCANNING: [], S.STARVED: [E.POINTS_SHORT], S.BLOCKED: [E.RING_FULL]}
EXITS = [(state, event) for (state, event), after in TRANSITIONS.items() if state in RUNNING and after not in RUNNING]


def scanning(count: int = 500) -> Bench:
    bench = Bench()
    bench.scan(count)
    bench.run(60)
    assert bench.device.state is S.SCANNING
    assert bench.instrument.open_now
    return bench


@pytest.mark.parametrize(("state", "event"), EXITS, ids=lambda item: item.name)
def test_every_way_out_of_a_running_scan_closes_the_shutter_at_once(state, event):
    bench = scanning()
    for step in INTO[state]:
        bench.device.transition(step)
    assert bench.device.state is state
    assert bench.instrument.shutter.count("open") == 1, "it is open as long as the scan runs"
    bench.device.transition(event)
    assert bench.instrument.shutter[-1] == "close"
    assert not bench.instrument.open_now


def hello(bench: Bench) -> None:
    bench.host = Host(nonce=2)
    bench.connect()


WAYS = {
    "pause": (lambda bench: bench.call(Operation.PAUSE), S.PAUSED),
    "disarm": (lambda bench: bench.call(Operation.DISARM), S.READY),
    "abort pause": (lambda bench: bench.host.abort(AbortLevel.PAUSE, bench.clock.now()), S.PAUSED),
    "abort laser off": (lambda bench: bench.host.abort(AbortLevel.LASER_OFF, bench.clock.now()), S.SAFE_HOLD),
    "emergency stop": (lambda bench: bench.host.abort(AbortLevel.EMERGENCY_STOP, bench.clock.now()), S.ESTOP),
    "lease": (lambda bench: setattr(bench, "consuming", False), S.SAFE_HOLD),
    "new session": (hello, S.SAFE_HOLD),
    "interlock": (lambda bench: setattr(bench.instrument, "closed", False), S.FAULT),
    "key": (lambda bench: setattr(bench.instrument, "key", False), S.FAULT),
    "last point": (lambda bench: None, S.DONE),
}


@pytest.mark.parametrize("way", WAYS)
def test_scan_end_of_any_cause_reports_closed_shutter(way):
    act, state = WAYS[way]
    bench = scanning(40 if way == "last point" else 500)
    assert bench.host.status.laser & (SHUTTER_OPEN | LASER_EMITTING) == SHUTTER_OPEN | LASER_EMITTING
    act(bench)
    bench.until(lambda: bench.host.device_state is state and bench.host.status.state == state, 3_000)
    shots = len(bench.instrument.log)
    assert not bench.instrument.open_now
    assert not bench.host.status.laser & (SHUTTER_OPEN | LASER_EMITTING)
    bench.run(1_000)
    assert len(bench.instrument.log) == shots
    assert bench.instrument.shutter.count("open") == 1


def test_the_shutter_stays_closed_until_start():
    bench = Bench()
    bench.connect()
    bench.upload(20)
    token = bench.call(Operation.ARM)["token"]
    bench.run(100)
    assert "open" not in bench.instrument.shutter
    bench.call(Operation.START, token=token, **bench.host.lease_fields())
    assert "open" in bench.instrument.shutter


@pytest.mark.parametrize("state", [S.IDLE, S.READY, S.ARMED, S.SCANNING])
def test_open_interlock_or_key_off_reported_always_and_faults_if_armed(state):
    for name, bit, fault in (("closed", INTERLOCK_CLOSED, FAULT_INTERLOCK), ("key", KEY_ON, FAULT_KEY)):
        bench = Bench()
        bench.connect()
        if state is not S.IDLE:
            bench.upload(500)
        if state is S.SCANNING:
            bench.start()
        elif state is S.ARMED:
            bench.call(Operation.ARM)
        setattr(bench.instrument, name, False)
        bench.run(300)
        assert not bench.host.status.laser & bit
        latched = state in (S.ARMED, S.SCANNING)
        assert (bench.device.state is S.FAULT) is latched
        assert bench.host.status.fault == (fault if latched else 0)


def test_stuck_shutter_is_reported_open_and_latches_fault(caplog):
    bench = scanning()
    bench.instrument.stuck = True
    bench.call(Operation.PAUSE)
    bench.run(300)
    assert bench.device.state is S.FAULT
    assert bench.host.status.fault == FAULT_SHUTTER
    assert bench.host.status.laser & SHUTTER_OPEN, "the read-back, not what was asked for"
    assert bench.instrument.shutter.count("close") > 2, "it is tried again"
    assert caplog.text.count("shutter-stuck") == 1, "logged once, not at each poll"
    bench.instrument.stuck = False
    bench.run(300)
    assert not bench.host.status.laser & SHUTTER_OPEN
    assert bench.device.state is S.FAULT, "latched"


SWEEP = {"x": 0, "y": 0, "from_pm": 1_540_000, "to_pm": 1_560_000, "steps": 5}
CALLS = {
    "open": lambda bench: bench.start(),
    "close": lambda bench: bench.host.abort(AbortLevel.LASER_OFF, bench.clock.now()),
    "park": lambda bench: bench.call(Operation.PARK),
    "configure": lambda bench: bench.call(Operation.SET, power=2),
    "sweep": lambda bench: bench.call(Operation.TUNE_SCAN, **SWEEP),
    "sweep_result": lambda bench: bench.call(Operation.TUNE_SCAN, **SWEEP),
    "begin": lambda bench: bench.upload(9),
    "parameters": lambda bench: bench.call(Operation.GET),
    "shots": lambda bench: bench.call(Operation.GET),
    **{name: lambda bench: bench.start() for name in ("queue_points", "permit", "poll", "next_due")},
    "stop": lambda bench: bench.start() or bench.run(50) or bench.call(Operation.PAUSE),
    **{name: lambda bench: None for name in ("position", "interlock_closed", "key_on", "shutter_open", "emitting")},
}


@pytest.mark.parametrize("name", CALLS)
def test_a_failure_of_any_call_to_the_hardware_is_a_latched_fault_and_the_device_goes_on_answering(name):
    bench = Bench()
    bench.connect()
    bench.upload(30)
    if name == "close":
        bench.start()
        bench.run(30)
    bench.instrument.broken = name
    with suppress(ScannerError, NotReached):
        CALLS[name](bench)
        bench.run(300)
    bench.until(lambda: bench.host.device_state is S.FAULT and bench.host.status.fault == 9, 2_000)
    shots = len(bench.instrument.log)
    bench.run(500)
    assert len(bench.instrument.log) == shots
    bench.instrument.broken = None
    bench.call(Operation.CLEAR_FAULT)
    assert bench.device.state is S.SAFE_HOLD
    assert not bench.instrument.open_now


@pytest.mark.parametrize("state", [S.FAULT, S.ESTOP])
def test_nothing_moves_and_nothing_is_changed_in_a_latched_state(state):
    bench = Bench()
    bench.connect()
    bench.upload(30)
    bench.device.transition(E.HARDWARE_FAULT if state is S.FAULT else E.EMERGENCY_STOP)
    moved = []
    for name in ("park", "sweep", "configure", "queue"):
        setattr(bench.instrument, name, partial(moved.append, name))
    for operation, body in ((Operation.PARK, {}), (Operation.SET, {"power": 2}), (Operation.TUNE_SCAN, SWEEP)):
        with pytest.raises(RequestRejected, match="wrong-state"):
            bench.call(operation, **body)
    assert moved == []


@pytest.mark.parametrize(
    ("wavelength", "refused"), [(0, False), (1_500_000, False), (1_499_999, True), (1 << 31, True)]
)
def test_a_bias_wavelength_outside_the_lasers_range_is_refused_with_its_points(wavelength, refused):
    bench = Bench()
    bench.connect()
    plan = bench.upload(5)
    plan.points["wavelength"] = wavelength
    call = bench.host.upload(plan, bench.clock.now())
    bench.until(lambda: call.done)
    bench.run(200)
    assert bench.host.uploader.refused is refused
    assert (bench.device.plan.expected == 0) is refused


def test_a_pause_while_armed_spends_the_token():
    for pause in (
        lambda bench: bench.host.abort(AbortLevel.PAUSE, bench.clock.now()),
        lambda bench: bench.call(Operation.PAUSE),
    ):
        bench = Bench()
        bench.connect()
        bench.upload(30)
        token = bench.call(Operation.ARM)["token"]
        pause(bench)
        bench.run(50)
        assert bench.device.state is S.READY
        assert bench.device.token is None
        with pytest.raises(RequestRejected):
            bench.call(Operation.START, token=token, **bench.host.lease_fields())


def test_an_a_line_that_no_message_can_hold_is_a_latched_fault_and_the_device_goes_on_answering():
    """A level of 40 V does not fit in the field of millivolts: the hardware's fault, told as such."""
    bench = Bench()
    bench.connect()
    bench.upload(30)
    poll = bench.instrument.poll
    bench.instrument.poll = lambda now: [replace(each, dc=40_000) for each in poll(now)]
    bench.start()
    bench.until(lambda: bench.host.device_state is S.FAULT, 2_000)
    bench.instrument.poll = poll
    bench.call(Operation.CLEAR_FAULT)
    assert not bench.instrument.open_now
    bench.call(Operation.RELEASE)
    bench.start()
    bench.finish()
    bench.check_exact(30)
