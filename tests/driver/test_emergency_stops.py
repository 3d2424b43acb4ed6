"""Emergency stop from a second program: off by the simulator's own account, or the answer is 'unconfirmed'."""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
import threading
import time

import numpy as np
import pytest
from driver_holders import ANOTHER_USER, FAST, FOREIGN, LIAR, program, report, scan_of

import fabry_perot
from fabry_perot.host.control_server import ControlServer
from fabry_perot.simulator import launch
from support import copies
from support.waiting import until

QUICK = 250_000
"""Longest time from the request to the last shot, in µs of the simulator."""
PAT = {"who": "Pat", "timeout": 20.0}
PATIENT = fabry_perot.host.HostTiming(ttl=1_000_000)


def stopped_by_then(simulator, answer, asked_at) -> bool:
    """Check an answer against the simulator's own account, and return whether the laser was off soon enough."""
    after = report(simulator)
    assert answer.laser in ("off", "unconfirmed")
    if answer.laser == "off":
        assert not after["shutter"], "the answer was 'off' while the shutter was open"
        assert after["state"] not in ("armed", "scanning", "starved", "blocked")
    else:
        assert answer.detail.endswith("use the hardware switch")
    return not after["shutter"] and after["last_shot"] - asked_at <= QUICK


def stop(simulator, **options):
    """Ask for a stop, and return the answer and the simulator's time before."""
    before = report(simulator)["time"]
    return fabry_perot.emergency_stop(simulator.url, timeout=20.0, **options), before


def test_emergency_stop_of_idle_port_returns_device_status():
    """A host of another test may wait for an earlier device of the same name, and then answers: not five times."""
    for _ in range(5):
        with launch() as simulator:
            answer, _ = stop(simulator)
            assert (answer.laser, answer.shutter) == ("off", "closed")
            if answer.holder:
                continue
            assert answer.state in ("idle", "linked")
            with fabry_perot.connect(simulator.url) as scanner:
                assert scanner.state == "linked", "the port is free again"
            return
    pytest.fail(f"{answer.holder} holds each of five new ports")


@pytest.mark.long
@pytest.mark.parametrize("line", ["terminal", "tcp"])
def test_emergency_stop_while_another_program_scans_turns_its_laser_off_and_ends_the_scan(line, tmp_path):
    """Other work of this machine may delay it, so one of several attempts has to be quick; none may be untrue."""
    quick = []
    for attempt in range(6):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        with (
            launch(**FAST, tcp="127.0.0.1:0" if line == "tcp" else None) as simulator,
            scan_of(simulator, folder) as scan,
        ):
            answer, asked_at = stop(simulator, who="Pat")
            in_time = stopped_by_then(simulator, answer, asked_at)
            assert (answer.laser, answer.shutter, answer.state) == ("off", "closed", "safe_hold")
            quick.append(in_time and answer.holder == f"fabry_perot (process {scan.pid})")
            if not answer.holder:
                continue  # the program did not answer in time, so the stop went past it
            said, errors = scan.communicate(timeout=250)
            shots = report(simulator)["shots"]
        assert scan.returncode == 1
        assert "stopped by an emergency stop from Pat" in errors
        assert int(np.load(folder / "scan.npy")["stored"].sum()) == shots, "all that was fired is kept"
        assert f"{shots} of 5000 A-lines" in said
        if quick[-1]:
            return
    pytest.fail(f"in none of {len(quick)} attempts did the program answer and turn the laser off within 250 ms")


@pytest.mark.long
def test_emergency_stop_of_a_frozen_program_goes_past_it_to_the_device(tmp_path):
    quick = []
    for attempt in range(6):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        with launch(**FAST) as simulator, scan_of(simulator, folder) as scan:
            os.kill(scan.pid, signal.SIGSTOP)
            answer, asked_at = stop(simulator)
            quick.append(stopped_by_then(simulator, answer, asked_at))
            assert (answer.laser, answer.state) == ("off", "safe_hold")
            assert f"(process {scan.pid})" in answer.holder
            shots = report(simulator)["shots"]
            os.kill(scan.pid, signal.SIGCONT)
            scan.communicate(timeout=250)
            assert scan.returncode == 1
            assert report(simulator)["shots"] == shots, "the program that woke up fires nothing more"
        if quick[-1]:
            return
    pytest.fail(f"the laser was off later than 250 ms in each of {len(quick)} attempts")


def test_emergency_stop_of_a_port_that_a_program_without_this_driver_has_locked_reaches_the_device():
    with launch() as simulator, program(FOREIGN, simulator.url) as other:
        assert other.stdout.readline() == "held\n"
        answer, asked_at = stop(simulator)
        stopped_by_then(simulator, answer, asked_at)
        assert answer.laser == "off"
        assert f"(process {other.pid})" in answer.holder


def test_emergency_stop_of_a_port_that_does_not_exist_is_unconfirmed_at_once(tmp_path):
    answer = fabry_perot.emergency_stop(str(tmp_path / "nothing"))
    assert answer.laser == "unconfirmed"
    assert answer.shutter == "unknown"
    assert "could not be asked" in answer.detail
    assert answer.detail.endswith("use the hardware switch")
    assert answer.seconds < 2


def test_emergency_stop_of_a_host_that_does_not_answer_is_unconfirmed_within_its_timeout():
    """The connection waits in the backlog of a port that takes none; that would last minutes."""
    with socket.create_server(("127.0.0.1", 0), backlog=0) as full:
        waiting = [socket.socket() for _ in range(4)]
        for each in waiting:
            each.setblocking(False)
            each.connect_ex(full.getsockname())
        answer = fabry_perot.emergency_stop(f"socket://127.0.0.1:{full.getsockname()[1]}", timeout=0.3)
        for each in waiting:
            each.close()
    assert answer.laser == "unconfirmed"
    assert answer.detail.endswith("use the hardware switch")


def test_emergency_stop_of_a_line_that_is_cut_is_unconfirmed():
    with launch() as simulator:
        simulator.send_command("cut", way="up", seconds=1000)
        answer = fabry_perot.emergency_stop(simulator.url, timeout=0.5)
    assert (answer.laser, answer.shutter) == ("unconfirmed", "unknown")
    assert "no scanner answered" in answer.detail


@pytest.mark.long
def test_emergency_stop_during_unplug_keeps_laser_off_after_reconnect(tmp_path):
    """It comes back so soon that the scan would be taken up; a stop that a busy machine delays does not count."""
    for attempt in range(6):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        with launch(**FAST) as simulator, scan_of(simulator, folder) as scan:
            began = simulator.send_command("unplug", seconds=1.5)["time"]
            answer = fabry_perot.emergency_stop(simulator.url, timeout=0.9, who="Pat")
            if report(simulator)["time"] - began > 1_400_000 or not answer.holder:
                continue
            assert answer.laser == "unconfirmed"
            assert f"(process {scan.pid})" in answer.holder
            _, errors = scan.communicate(timeout=250)
            assert "stopped by an emergency stop from Pat" in errors, errors
            after = report(simulator)
            assert not after["shutter"]
            assert after["last_shot"] < began + 1_000_000
            return
    pytest.fail("no stop came while the line was away")


def test_emergency_stop_before_arm_prevents_arming():
    parameters = {"samples": 64, "sampling_interval": 8e-9, "pulse_rate": 100.0}
    with launch(speed=5) as simulator, fabry_perot.connect(simulator.url, timing=PATIENT) as scanner:
        scanner.upload([(0.0, 0.0)] * 20, **parameters)
        assert fabry_perot.emergency_stop(simulator.url, timeout=20.0, who="Pat").laser == "off"
        with pytest.raises(fabry_perot.ScanAborted, match="stopped by an emergency stop from Pat"):
            scanner.arm()
        assert report(simulator)["shots"] == 0
        cleared = scanner.clear_fault("Kim")
        assert (cleared.by, cleared.fault.name) == ("Kim", "emergency-stop")
        scanner.start(scanner.arm())
        assert sum(len(batch) for batch in scanner.alines()) == 20


def test_scan_stopped_before_its_program_reads_the_request_is_told_the_name(monkeypatch):
    """A program that answers late is passed by, so the device reports the stop before the program reads the name."""
    attend = ControlServer._attend
    monkeypatch.setattr(ControlServer, "_attend", lambda *told: (time.sleep(0.5), attend(*told)))
    parameters = {"samples": 64, "sampling_interval": 8e-9, "pulse_rate": 100.0}
    with launch(speed=5) as simulator, fabry_perot.connect(simulator.url, timing=PATIENT) as scanner:
        scanner.upload([(0.0, 0.0)] * 10_000, **parameters)
        scanner.start(scanner.arm())
        stopping = threading.Thread(target=fabry_perot.emergency_stop, args=(simulator.url,), kwargs=PAT)
        stopping.start()
        with pytest.raises(fabry_perot.ScanAborted, match="stopped by an emergency stop from Pat"):
            sum(1 for _ in scanner.alines())
        stopping.join()


def test_emergency_stop_of_a_scan_that_a_person_resumes_loses_nothing():
    parameters = {"samples": 64, "sampling_interval": 8e-9, "pulse_rate": 100.0}
    lines: list = []
    with launch(speed=5, noise_db=60.0) as simulator, fabry_perot.connect(simulator.url, timing=PATIENT) as scanner:
        scanner.upload([(0.0, 0.0)] * 300, **parameters)
        scanner.start(scanner.arm())
        stopped = False
        while len(lines) < 300:
            try:
                for batch in scanner.alines():
                    lines += batch
                    scanner.acknowledge(batch[-1])
                    if not stopped and len(lines) > 20:
                        stopped = fabry_perot.emergency_stop(simulator.url, timeout=20.0).laser == "off"
                        assert stopped
            except (fabry_perot.ScanAborted, fabry_perot.LeaseExpired):
                scanner.resume()
        assert report(simulator)["shots"] == 300
    assert [line.number for line in lines] == list(range(300))


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux" or os.geteuid() != 0, reason="only root can become another user")
def test_emergency_stop_without_port_permission_is_relayed_by_port_holder(tmp_path):
    with launch(**FAST) as simulator:
        terminal = os.path.realpath(simulator.url)
        os.chmod(terminal, 0o600)
        with program(ANOTHER_USER, terminal) as guest:
            alone = json.loads(guest.communicate(timeout=250)[0])
        assert alone["laser"] == "unconfirmed"
        assert "ermission" in alone["detail"]
        with scan_of(simulator, tmp_path) as scan, program(ANOTHER_USER, terminal) as guest:
            beside = json.loads(guest.communicate(timeout=250)[0])
            assert beside["laser"] == "off"
            assert not report(simulator)["shutter"]
            assert "emergency stop from guest" in scan.communicate(timeout=250)[1]


@pytest.mark.long
def test_emergency_stop_believes_no_process_that_does_not_hold_the_port(tmp_path):
    with launch(**FAST) as simulator, scan_of(simulator, tmp_path) as scan:
        with program(LIAR, simulator.url) as liar:
            assert liar.stdout.readline() == "lying\n"
            os.kill(scan.pid, signal.SIGSTOP)
            answer, asked_at = stop(simulator)
            assert "all is well" not in answer.detail
            assert str(liar.pid) not in answer.holder
            stopped_by_then(simulator, answer, asked_at)
            assert answer.laser == "off"


@pytest.mark.long
@pytest.mark.parametrize("line", ["terminal", "tcp"])
def test_stop_command_prints_device_status_and_fails_if_unreachable(line, tmp_path):
    with launch(**FAST, tcp="127.0.0.1:0" if line == "tcp" else None) as simulator:
        with scan_of(simulator, tmp_path) as scan:
            done = command("stop", simulator.url, "--by", "Pat")
            assert done.returncode == 0, done.stderr
            assert done.stdout.startswith("laser off: the scanner reports that the laser is off (state safe_hold")
            assert f"(process {scan.pid})" in done.stdout
            assert not report(simulator)["shutter"]
    failed = command("stop", simulator.url)
    assert failed.returncode == 1
    assert failed.stdout == ""
    assert failed.stderr.startswith("laser unconfirmed: ")
    assert failed.stderr.endswith("use the hardware switch\n")


def command(*words):
    return copies.run([sys.executable, "-m", "fabry_perot", *words])


@pytest.mark.long
def test_emergency_stop_under_faults_never_reports_off_with_open_shutter(tmp_path):
    rng = np.random.default_rng(7)
    for number in range(25):
        folder = tmp_path / str(number)
        folder.mkdir()
        with (
            launch(**FAST, tcp="127.0.0.1:0" if rng.random() < 0.3 else None) as simulator,
            scan_of(simulator, folder) as scan,
        ):
            for trouble in rng.permutation(["freeze", "unplug", "cut up", "cut down", "stall", "interlock"])[:2]:
                match trouble.split():
                    case ["freeze"]:
                        os.kill(scan.pid, signal.SIGSTOP)
                    case ["unplug"]:
                        simulator.send_command("unplug", seconds=float(rng.uniform(0.1, 2)))
                    case [("cut" | "stall") as fault, *way]:
                        simulator.send_command(fault, way=(way or ["up"])[0], seconds=float(rng.uniform(0.1, 2)))
                    case ["interlock"]:
                        simulator.send_command("interlock", closed=False)
                time.sleep(float(rng.uniform(0, 0.3)))
            began = time.monotonic()
            answer = fabry_perot.emergency_stop(simulator.url)
            after = report(simulator)
            assert answer.laser == "unconfirmed" or not after["shutter"], (number, answer)
            assert answer.laser == "off" or answer.detail.endswith("use the hardware switch")
            assert time.monotonic() - began < 60
            until(lambda: not report(simulator)["shutter"])
