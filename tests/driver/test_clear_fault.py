"""Faults: named with a remedy, cleared by a person once the cause is gone; the scan then goes on exactly once."""

from __future__ import annotations

import pickle
import re
import sys

import numpy as np
import pytest
from driver_bench import Bench
from driver_holders import report

import fabry_perot
from fabry_perot import fault_codes
from fabry_perot.host import HostTiming
from fabry_perot.host.monitoring_transport import format_frame
from fabry_perot.simulator import launch
from fabry_perot.wire.constants import Operation, Type
from fabry_perot.wire.framing import Frame
from fabry_perot.wire.messages import Fault, pack
from fabry_perot.wire.states import DeviceState, Event
from support import copies
from support.waiting import until

PATIENT = HostTiming(ttl=1_000_000)
PARAMETERS = {"samples": 64, "sampling_interval": 8e-9, "pulse_rate": 100.0}
COUNT = 400
WHERE = np.random.default_rng(0).uniform(-6e-3, 6e-3, (COUNT, 2)).round(6)


@pytest.fixture
def simulator():
    with launch(speed=5, noise_db=60.0) as running:
        yield running


def command(*words):
    return copies.run([sys.executable, "-m", "fabry_perot", *words])


def scan_until_it_stops(scanner, lines, then=None):
    """Take A-lines until the scan stops, and return the error that says why; what a busy machine lets lapse goes on."""
    while len(lines) < COUNT:
        try:
            for batch in scanner.alines():
                lines += batch
                scanner.acknowledge(batch[-1])
                if then is not None and len(lines) > 30:
                    then, _ = None, then()
        except fabry_perot.LeaseExpired:
            scanner.resume()
        except fabry_perot.ScannerError as error:
            return error
    return None


def interrupted(scanner, simulator, lines):
    """Run a scan into an interlock that opens, and return the error."""
    scanner.upload(WHERE, **PARAMETERS)
    scanner.start(scanner.arm())
    error = scan_until_it_stops(scanner, lines, then=lambda: simulator.send_command("interlock", closed=False))
    assert isinstance(error, fabry_perot.DeviceFault)
    assert not report(simulator)["shutter"]
    return error


def test_an_interlock_that_opened_is_named_with_its_remedy_and_the_command_that_clears_it(simulator):
    with fabry_perot.connect(simulator.url, timing=PATIENT) as scanner:
        error = interrupted(scanner, simulator, [])
        assert error.fault == fault_codes.INTERLOCK_OPENED.code
        for words in ("the interlock was opened", "close the enclosure", f"fabry-perot clear-fault {simulator.url}"):
            assert words in str(error)
        assert not re.search(r"fault \d", str(error))
        with pytest.raises(fabry_perot.DeviceFault, match=r"interlock.*clear-fault"):
            scanner.resume()
        with pytest.raises(fabry_perot.DeviceFault, match=r"interlock.*clear-fault"):
            scanner.upload(WHERE, **PARAMETERS, resume=True)
        with pytest.raises(fabry_perot.DeviceFault, match=r"interlock.*clear-fault"):
            scanner.arm()
        with pytest.raises(fabry_perot.DeviceFault, match=r"interlock.*clear-fault"):
            scanner.tune(0.0, 0.0)


def test_clear_fault_with_active_cause_refused_then_scan_completes_once(simulator):
    lines: list = []
    with fabry_perot.connect(simulator.url, timing=PATIENT) as scanner:
        interrupted(scanner, simulator, lines)
        with pytest.raises(fabry_perot.FaultStands, match="the interlock is open") as stands:
            scanner.clear_fault("Kim")
        assert (stands.value.fault, stands.value.code) == (1, "fault-stands")
        assert scanner.state == "fault"
        simulator.send_command("interlock", closed=True)
        until(lambda: scanner.status.laser & 8)
        cleared = scanner.clear_fault("Kim")
        assert (cleared.fault.name, cleared.by, cleared.state) == ("interlock-opened", "Kim", "safe_hold")
        assert "Kim cleared the fault interlock-opened" in str(cleared)
        scanner.resume()
        assert scan_until_it_stops(scanner, lines) is None
        assert scanner.report().is_balanced
    assert [line.number for line in lines] == list(range(COUNT))
    assert report(simulator)["shots"] == COUNT + scanner.status.shots_wasted


@pytest.mark.long
def test_clear_fault_before_host_restart_scan_completes_exactly_once(simulator):
    lines: list = []
    with fabry_perot.connect(simulator.url, timing=PATIENT) as scanner:
        interrupted(scanner, simulator, lines)
    refused = command("clear-fault", simulator.url, "--by", "Kim")
    assert refused.returncode == 1
    assert refused.stderr.startswith("error: the interlock is open, so the fault interlock-opened was not cleared")
    simulator.send_command("interlock", closed=True)
    cleared = command("clear-fault", simulator.url, "--by", "Kim")
    assert cleared.returncode == 0, cleared.stderr
    assert re.fullmatch(
        r"\d{4}-\d\d-\d\dT[\d:]+Z Kim cleared the fault interlock-opened; state safe_hold\n", cleared.stdout
    )
    with fabry_perot.connect(simulator.url, timing=PATIENT) as scanner:
        scanner.upload(WHERE, **PARAMETERS, resume=True, start=len(lines))
        scanner.start(scanner.arm())
        assert scan_until_it_stops(scanner, lines) is None
    assert [line.number for line in lines] == list(range(COUNT))


@pytest.mark.long
def test_status_and_watch_name_a_fault_and_its_remedy(simulator):
    with fabry_perot.connect(simulator.url, timing=PATIENT) as scanner:
        interrupted(scanner, simulator, [])
    status = command("status", simulator.url).stdout
    (line,) = [line for line in status.splitlines() if line.startswith("fault ")]
    assert "the interlock was opened" in line
    assert "clear-fault" in line
    watch = command("watch", simulator.url, "--count", "1").stdout
    assert "interlock-opened" in watch


@pytest.mark.long
def test_clearing_nothing_or_without_a_name_is_refused(simulator):
    nothing = command("clear-fault", simulator.url, "--by", "Kim")
    assert (nothing.returncode, nothing.stdout) == (1, "")
    assert "nothing is latched" in nothing.stderr
    assert command("clear-fault", simulator.url).returncode == 2
    assert "the name of a person" in command("clear-fault", simulator.url, "--by", " ").stderr


def test_every_fault_code_has_a_name_of_its_own_a_title_and_a_remedy():
    known = [fault_codes.by_code(code) for code in fault_codes.CODES]
    assert len({fault.name for fault in known}) == len(known)
    assert all(fault.title and fault.remedy and re.fullmatch(r"[a-z0-9-]+", fault.name) for fault in known)
    assert [fault.code for fault in known] == list(fault_codes.CODES)
    assert "excitation laser" in fault_codes.by_code(7).title


def test_errors_of_faults_survive_their_way_to_another_process():
    for error in (fabry_perot.DeviceFault(2, "/dev/ttyUSB0"), fabry_perot.FaultStands(2, "the key switch is off")):
        again = pickle.loads(pickle.dumps(error))  # noqa: S301
        assert (str(again), vars(again)) == (str(error), vars(error))


def test_a_frame_of_a_fault_is_shown_with_its_name():
    shown = format_frame(Frame(Type.FAULT, 2, 7, 1, 1, pack(Fault(1, 1))))
    assert "interlock-opened" in shown


@pytest.mark.parametrize("part", ["closed", "key"])
def test_device_clear_fault_with_active_cause_returns_wrong_state(part):
    bench = Bench()
    bench.connect()
    bench.upload(30)
    bench.start()
    bench.run(30)
    setattr(bench.instrument, part, False)
    bench.until(lambda: bench.host.device_state is DeviceState.FAULT, 2_000)
    with pytest.raises(fabry_perot.RequestRejected, match="wrong-state"):
        bench.call(Operation.CLEAR_FAULT)
    assert bench.device.state is DeviceState.FAULT
    setattr(bench.instrument, part, True)
    bench.call(Operation.CLEAR_FAULT)
    assert bench.device.state is DeviceState.SAFE_HOLD


def test_the_device_clears_no_emergency_stop_while_its_shutter_is_open():
    bench = Bench()
    bench.connect()
    bench.upload(30)
    bench.start()
    bench.run(30)
    bench.instrument.stuck = True
    bench.device.try_transition(Event.EMERGENCY_STOP)
    with pytest.raises(fabry_perot.RequestRejected, match="wrong-state"):
        bench.call(Operation.CLEAR_FAULT)
    bench.instrument.stuck = False
    bench.call(Operation.CLEAR_FAULT)
    assert bench.device.state is DeviceState.SAFE_HOLD
