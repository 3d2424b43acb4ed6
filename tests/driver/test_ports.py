"""Ports that fail, scanners that fall silent: what the threaded part of the driver makes of them."""

from __future__ import annotations

import threading
from collections import deque

import pytest
import serial
from driver_bench import CountingInstrument

from fabry_perot.clock import RealClock
from fabry_perot.device import Device
from fabry_perot.errors import (
    DeviceFault,
    EmergencyStopped,
    LeaseExpired,
    LinkLost,
    PlanInvalid,
    PortUnavailable,
    RequestRejected,
    ResponseTimeout,
    ScanAborted,
)
from fabry_perot.host import HostTiming, RecoveryPolicy, io_pump, transport
from fabry_perot.host.discovery import connect
from fabry_perot.host.io_pump import IoPump, stream_end_reason
from fabry_perot.host.link_states import HostState
from fabry_perot.host.scanner import Scanner
from fabry_perot.host.session import Session
from fabry_perot.host.transport import SocketTransport, TerminalTransport
from fabry_perot.simulator import launch
from fabry_perot.wire.constants import Operation
from fabry_perot.wire.states import DeviceState, HoldCause

EAGER = HostTiming(hello_period=1_000, hello_tries=3)


class BrokenPort:
    """A pyserial port whose device is gone: each call fails as pyserial's do."""

    in_waiting = 1

    def __init__(self, error: Exception) -> None:
        self.error = error

    def read(self, size: int) -> bytes:
        raise self.error

    def write(self, data: bytes) -> int:
        raise self.error

    def close(self) -> None:
        raise OSError(5, "gone")


@pytest.mark.parametrize("kind", [TerminalTransport, SocketTransport])
@pytest.mark.parametrize("error", [serial.SerialException("gone"), OSError(5, "gone"), TypeError("no descriptor")])
def test_serial_port_error_raises_link_lost_and_close_succeeds(kind, error):
    port = kind(BrokenPort(error))
    with pytest.raises(LinkLost):
        port.read()
    with pytest.raises(LinkLost):
        port.write(b"x")
    port.close()


class Wire:
    """A transport with a device on its other end, in memory."""

    def __init__(self, device: Device | None = None) -> None:
        self.device, self.clock = device, RealClock()
        self.begun = self.clock.now()
        self.closed = self.deaf = self.broken = False
        self._sent: deque[bytes] = deque()
        self._arrived = threading.Event()

    def read(self) -> bytes:
        if self.broken:
            raise LinkLost("pulled out")
        self._arrived.wait(0.002)
        self._arrived.clear()
        data = b"".join(self._sent.popleft() for _ in range(len(self._sent)))
        if self.device is None:
            return b""
        self.device.receive(data, self.clock.now() - self.begun)
        return self.device.next_frames(65536)

    def write(self, data: bytes) -> None:
        if self.deaf:
            raise LinkLost("cannot write")
        self._sent.append(data)
        self._arrived.set()

    def close(self) -> None:
        self.closed = True


def device() -> Device:
    return Device(CountingInstrument(), boot=0xB007)


def test_a_port_without_a_scanner_is_released_after_the_last_try():
    wire = Wire()
    with pytest.raises(ResponseTimeout, match="3 tries"):
        Session(wire, timing=EAGER)
    assert wire.closed


def test_session_wait_without_event_raises_response_timeout():
    session = Session(Wire(device()))
    try:
        with pytest.raises(ResponseTimeout, match=r"within 0\.01 s"):
            session.wait(lambda: False, 0.01)
    finally:
        session.close()


def test_port_with_failing_writes_is_reopened_with_retries(monkeypatch):
    monkeypatch.setattr(io_pump, "INITIAL_BACKOFF", 0.001)
    wire, tries = Wire(device()), []

    def reopen() -> Wire:
        tries.append(1)
        if len(tries) < 3:
            raise PortUnavailable("not yet")
        again = Wire(wire.device)
        again.begun = wire.begun
        return again

    session = Session(wire, reopen=reopen, patience=10.0)
    try:
        before = session.host.session
        wire.deaf = True
        with session.changed:
            session.host.call(1, session.now())
        session.flush()
        session.flush()
        session.wait(lambda: session.host.session not in (0, before), 5.0)
        assert (session.reconnects, len(tries), wire.closed) == (1, 3, True)
    finally:
        session.close()


def test_a_lost_port_that_does_not_come_back_fails_everything_under_way(monkeypatch):
    monkeypatch.setattr(io_pump, "INITIAL_BACKOFF", 0.001)
    wire = Wire(device())

    def reopen() -> Wire:
        raise PortUnavailable("never")

    session = Session(wire, reopen=reopen, patience=0.02)
    try:
        wire.broken = True
        with pytest.raises(LinkLost, match="pulled out"):
            session.wait(lambda: False, 5.0)
    finally:
        session.close()


def test_a_pump_that_never_ran_is_stopped_without_waiting():
    wire = Wire()
    IoPump(wire, Session.__new__(Session), RealClock(), threading.Condition()).stop()
    assert wire.closed


def test_scanner_without_connection_raises_response_timeout():
    scanner = Scanner(Wire(device()))
    with scanner:
        scanner._host.capabilities = scanner._host.status = None
        with pytest.raises(ResponseTimeout):
            _ = scanner.capabilities
        with pytest.raises(ResponseTimeout):
            _ = scanner.status


def test_resuming_a_plan_the_scanner_does_not_hold_and_a_start_beyond_the_plan_are_refused():
    with Scanner(Wire(device())) as scanner:
        parameters = {"samples": 64, "sampling_interval": 8e-9, "pulse_rate": 100.0}
        with pytest.raises(PlanInvalid, match="start"):
            scanner.upload([(0.0, 0.0)], start=1, **parameters)
        with pytest.raises(PlanInvalid, match="resume"):
            scanner.upload([(0.0, 0.0)], resume=True, **parameters)
        with pytest.raises(RequestRejected):
            scanner.arm()


def test_scanner_has_pending_data_until_fired_alines_are_delivered():
    with Scanner(Wire(device())) as scanner:
        assert not scanner.has_pending_data
        # more than the device holds: it cannot be done before the host acknowledges
        scanner.upload([(0.0, 0.0)] * 600, samples=64, sampling_interval=8e-9, pulse_rate=200.0)
        scanner.start(scanner.arm())
        lines: list = []
        for batch in scanner.alines(idle=True):
            lines += batch
            if len(lines) > 3 and scanner.state == "scanning":
                assert scanner.has_pending_data
                scanner.pause()
            if scanner.state == "paused" and not scanner.has_pending_data:
                break
        assert len(lines) == scanner.status.produced < 600
        assert not scanner.is_recovering


def test_a_recovery_that_ran_out_of_its_time_after_release_is_a_lapse_and_no_stop():
    """RELEASE clears the device's cause; nobody has stopped the scan all the same."""
    with Scanner(Wire(device()), recovery=RecoveryPolicy(within=0.0)) as scanner:
        scanner.upload([(0.0, 0.0)] * 3000, samples=64, sampling_interval=8e-9, pulse_rate=200.0)
        scanner.start(scanner.arm())
        scanner._session.wait(lambda: scanner.status.state == DeviceState.SAFE_HOLD, 20.0)
        scanner._session.request(Operation.RELEASE)
        with pytest.raises(LeaseExpired):
            deque(scanner.alines(), maxlen=0)
        assert scanner.state == "ready"


@pytest.mark.parametrize(
    ("state", "cause", "expected"),
    [
        (DeviceState.FAULT, HoldCause.NONE, DeviceFault),
        (DeviceState.ESTOP, HoldCause.NONE, EmergencyStopped),
        (DeviceState.READY, HoldCause.NONE, ScanAborted),
        (DeviceState.SAFE_HOLD, HoldCause.REQUEST, ScanAborted),
    ],
)
def test_each_way_a_scan_can_end_has_its_own_error(bench, state, cause, expected):
    bench.scan(5)
    bench.finish()
    assert stream_end_reason(bench.host, bench.clock.now(), 1_000_000) is None, "it is done, not stopped"
    bench.host.device_state = state
    assert stream_end_reason(bench.host, bench.clock.now(), 1_000_000) is None, "not before STATUS says the same"
    bench.host.status = bench.host.status._replace(state=state, cause=cause)
    assert isinstance(stream_end_reason(bench.host, bench.clock.now(), 1_000_000), expected)


def test_a_silent_line_is_waited_for_as_long_as_asked(bench):
    bench.scan(5)
    bench.finish()
    heard = bench.host.heard_at
    assert stream_end_reason(bench.host, heard + 1_000_000, 1_000_000) is None
    assert isinstance(stream_end_reason(bench.host, heard + 1_000_001, 1_000_000), LinkLost)


@pytest.mark.parametrize("phase", [HostState.LOST, HostState.HELLO])
def test_lost_line_of_held_scan_is_reported_as_lost_line(bench, phase):
    bench.scan(5)
    bench.finish()
    held = {"state": DeviceState.SAFE_HOLD, "cause": HoldCause.LEASE}
    bench.host.device_state, bench.host.status = DeviceState.SAFE_HOLD, bench.host.status._replace(**held)
    heard = bench.host.heard_at
    assert isinstance(stream_end_reason(bench.host, heard, 1_000_000), LeaseExpired)
    bench.host.phase = phase
    assert stream_end_reason(bench.host, heard + 1_000_000, 1_000_000) is None, "its state is not known"
    assert isinstance(stream_end_reason(bench.host, heard + 1_000_001, 1_000_000), LinkLost)


def test_a_port_that_cannot_be_locked_is_busy_and_one_that_is_not_there_unavailable(monkeypatch):
    def refuse(*arguments, **keywords):
        raise serial.SerialException("Could not exclusively lock port")

    monkeypatch.setattr(transport.serial, "Serial", refuse)
    with pytest.raises(transport.PortBusy):
        transport.open_transport("/dev/null")
    with pytest.raises(PortUnavailable):
        transport.open_transport("nonsense://there")


def test_abort_with_failing_tap_callback_is_still_sent():
    """As after ``| head``: the port outlives its onlooker."""

    def show(line: str) -> None:
        lines.append(line)
        raise BrokenPipeError

    lines: list[str] = []
    with launch() as simulator, connect(simulator.url, tap=show) as scanner:
        scanner.abort("emergency-stop")
        assert simulator.send_command("report")["state"] == "estop"
    assert len(lines) == 1
