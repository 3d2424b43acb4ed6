"""A service that runs no scan of its own stops the laser that another program fires on its port, or says why not.

The simulated scanner's own account tells whether its shutter is open and when it fired last.
"""

import os
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest

from fabry_perot.simulator import launch
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.plans.files import write_json
from support.services import Service
from support.waiting import until

STOP = "/scanners/scanner-0/emergency-stop"
SCANNER = "/scanners/scanner-0"
pytestmark = pytest.mark.timeout(300)
POINTS = "x_mm,y_mm\n" + "".join(f"{0.01 * n},0\n" for n in range(400))


@pytest.fixture(scope="module")
def scanner():
    with launch() as simulator:
        yield simulator


@pytest.fixture(scope="module")
def service(scanner, tmp_path_factory):
    service = Service(tmp_path_factory.mktemp("service"), scanner=scanner.url, workers=0).start()
    yield service
    service.close()


@pytest.fixture
def released(service):
    """The service with its stop released, before and after."""
    yield service
    service.http.delete(STOP)


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    mask = equi_steradian_mask(aperture=13.56e-3, depth=3.6e-3, count=900)
    path = tmp_path_factory.mktemp("plan") / "plan.json"
    write_json(ScanPlan.create(mask=mask, samples=256, pulse_rate=20.0), path)
    return path


@contextmanager
def running(*command, **how):
    """A program that runs until the block ends; its output is part of the test's."""
    program = subprocess.Popen(command, **how)
    try:
        yield program
    finally:
        program.send_signal(signal.SIGCONT)
        program.terminate()
        program.wait(60)


def shot(scanner, program=None):
    """Wait until the simulated scanner fires; returns its account of that moment."""
    before = scanner.send_command("report", fired=False)["shots"]

    def fired():
        assert program is None or program.poll() is None, "the program has ended"
        return (now := scanner.send_command("report", fired=False))["shots"] > before + 2 and now

    return until(fired)


def press(service):
    """Press the stop; returns what was answered and in how many seconds."""
    began = time.monotonic()
    answer = service.http.post(STOP, json={"reason": "smoke"})
    assert answer.status_code == 202, answer.text
    return answer.json()["emergency_stop"], time.monotonic() - began


def assert_dark(scanner, before, told):
    """The laser was off within 250 ms by the scanner's clock, and it says so itself."""
    after = scanner.send_command("report", fired=False)
    assert told["laser"] == "off", told
    assert not after["shutter"]
    assert after["last_shot"] - before["time"] < 1_500_000, (before, after)  # the press came somewhere between
    until(lambda: scanner.send_command("report", fired=False)["time"] > after["time"] + 500_000)
    assert scanner.send_command("report", fired=False)["shots"] == after["shots"]


@pytest.mark.walk
def test_emergency_stop_while_scan_run_fires_turns_the_laser_off(scanner, released, plan, tmp_path):
    command = (sys.executable, "-m", "steradian", "scan", "run", str(plan), "--scanner", scanner.url)
    with running(*command, "-o", str(tmp_path / "scan.h5")) as program:
        shot(scanner, program)
        shown = until(lambda: (now := released.get(SCANNER).json())["laser"] == "on" and now)
        assert (shown["connection"], shown["state"]) == ("in-use", "scanning")
        assert "process" in shown["holder"]
        assert shown["age"] < 1
        before = shot(scanner)
        told, _ = press(released)
        assert_dark(scanner, before, told)
        assert "process" in told["detail"] or told["detail"]


@pytest.mark.long
def test_emergency_stop_while_fabry_perot_scan_fires_turns_the_laser_off(scanner, released, tmp_path):
    (tmp_path / "points.csv").write_text(POINTS)
    command = (sys.executable, "-m", "fabry_perot", "scan", scanner.url, str(tmp_path / "points.csv"))
    with running(*command, "-o", str(tmp_path / "lines.npy")) as program:
        before = shot(scanner, program)
        told, _ = press(released)
        assert_dark(scanner, before, told)


@pytest.mark.long
def test_emergency_stop_while_a_frozen_program_holds_the_port_turns_the_laser_off(scanner, released, plan, tmp_path):
    command = (sys.executable, "-m", "steradian", "scan", "run", str(plan), "--scanner", scanner.url)
    with running(*command, "-o", str(tmp_path / "scan.h5")) as program:
        shot(scanner, program)
        os.kill(program.pid, signal.SIGSTOP)
        told, seconds = press(released)
        assert seconds < 2.5 or told["laser"] == "off"
        assert told["laser"] == "off" or told["detail"].endswith("use the hardware switch")
        assert not scanner.send_command("report", fired=False)["shutter"]


@pytest.mark.long
def test_emergency_stop_while_another_service_fires_turns_the_laser_off(scanner, released, tmp_path):
    other = Service(tmp_path, scanner=scanner.url, workers=0).start()
    try:
        other.start_scan(other.plan(900, pulse_rate=20))
        before = shot(scanner)
        told, _ = press(released)
        assert_dark(scanner, before, told)
    finally:
        other.close()


@pytest.mark.long
def test_emergency_stop_with_the_database_locked_turns_another_programs_laser_off(scanner, released, plan, tmp_path):
    command = (sys.executable, "-m", "steradian", "scan", "run", str(plan), "--scanner", scanner.url)
    with running(*command, "-o", str(tmp_path / "scan.h5")):
        before = shot(scanner)
        with sqlite3.connect(released.folder / "steradian.sqlite", isolation_level=None) as holder:
            holder.execute("BEGIN EXCLUSIVE")
            told, _ = press(released)
            assert_dark(scanner, before, told)
            holder.execute("ROLLBACK")
        holder.close()


@pytest.mark.long
def test_active_emergency_stop_halts_other_program_that_fires(scanner, released, plan, tmp_path):
    assert press(released)[0]["laser"] == "off"
    before = scanner.send_command("report", fired=False)["shots"]
    command = (sys.executable, "-m", "steradian", "scan", "run", str(plan), "--scanner", scanner.url)
    with running(*command, "-o", str(tmp_path / "scan.h5")):
        until(lambda: scanner.send_command("report", fired=False)["shots"] > before)
        until(lambda: not scanner.send_command("report", fired=False)["shutter"])
        assert released.get(SCANNER).json()["emergency_stop"]["laser"] in {"off", "unconfirmed"}


def test_emergency_stop_of_idle_scanner_reports_device_state(scanner, released):
    until(lambda: released.get(SCANNER).json()["connection"] == "connected")
    told, _ = press(released)
    assert told["laser"] == "off"
    assert "shutter closed" in told["detail"]


@pytest.mark.long
def test_emergency_stop_of_missing_scanner_is_unconfirmed_with_reason(tmp_path):
    port = tmp_path / "port"
    service = Service(tmp_path / "data", log=tmp_path / "log", scanner=str(port), workers=0)
    service.folder.mkdir()
    service.start()
    try:
        shown = until(lambda: (now := service.get(SCANNER).json())["connection"] == "disconnected" and now)
        assert str(port) in shown["last_error"]
        assert (shown["laser"], shown["age"], shown["looked_at"]) == ("unknown", None, None)
        until(lambda: f"the scanner at {port} was not found" in (tmp_path / "log").read_text())
        told, seconds = press(service)
        assert told["laser"] == "unconfirmed"
        assert str(port) in told["detail"]
        assert told["detail"].endswith("use the hardware switch")
        assert seconds < 2.5
        with launch(link=str(port)) as scanner:
            until(lambda: _stop(service)["laser"] == "off")
            assert not scanner.send_command("report", fired=False)["shutter"]
            assert (
                until(lambda: (now := service.get(SCANNER).json())["connection"] == "connected" and now)["last_error"]
                is None
            )
    finally:
        service.close()


@pytest.mark.long
def test_emergency_stop_of_a_simulated_scanner_that_was_never_started_is_idle(tmp_path):
    service = Service(tmp_path, workers=0).start()
    try:
        told, _ = press(service)
        assert told["laser"] == "idle"
        assert "not running" in told["detail"]
    finally:
        service.close()


def _stop(service):
    return service.get(SCANNER).json()["emergency_stop"]


@pytest.mark.long
def test_scanner_shown_right_after_a_stop_is_off_and_stays_so(scanner, released, plan, tmp_path):
    """What was heard before the stop does not come back: neither laser nor stop flicker."""
    command = (sys.executable, "-m", "steradian", "scan", "run", str(plan), "--scanner", scanner.url)
    with running(*command, "-o", str(tmp_path / "scan.h5")):
        until(lambda: released.get(SCANNER).json()["laser"] == "on")
        assert press(released)[0]["laser"] == "off"
        for _ in range(30):
            shown = released.get(SCANNER).json()
            assert shown["laser"] in {"off", "unknown"}
            assert shown["emergency_stop"]["laser"] == "off"
