"""``steradian scanner`` on a port that nobody holds, with a real simulated scanner."""

import subprocess
import sys

import pytest

from fabry_perot.simulator import launch
from support.commands import command
from support.waiting import until


@pytest.fixture
def scanner():
    with launch() as simulator:
        yield simulator


def test_scanner_status_command_prints_scanner_state(scanner):
    scanner.send_command("interlock", closed=False)
    shown = command("scanner", "status", "--scanner", scanner.url)
    assert shown.returncode == 0, shown.stderr
    said = dict(line.split(None, 1) for line in shown.stdout.splitlines() if len(line.split()) > 1)
    assert {"laser": "off", "shutter": "closed", "interlock": "open", "key": "on"}.items() <= {
        name: value.strip() for name, value in said.items()
    }.items()


def test_scanner_stop_command_reports_laser_off(scanner):
    stopped = command("scanner", "stop", "--scanner", scanner.url, "--by", "Ada")
    assert (stopped.returncode, stopped.stdout.split(":")[0]) == (0, "laser off")


def test_scanner_stop_of_no_port_ends_with_5_and_names_the_hardware_switch(tmp_path):
    stopped = command("scanner", "stop", "--scanner", str(tmp_path / "nothing"))
    assert stopped.returncode == 5
    assert "unconfirmed" in stopped.stderr
    assert "use the hardware switch" in stopped.stderr


def test_scanner_clear_fault_without_a_fault_does_nothing(scanner):
    cleared = command("scanner", "clear-fault", "--scanner", scanner.url, "--by", "Ada")
    assert (cleared.returncode, cleared.stdout.strip()) == (0, "no fault is latched; the scanner reports linked")


@pytest.mark.long
def test_scan_resume_on_a_latched_fault_names_the_command_that_clears_it_and_goes_on_after_it(tmp_path):
    run = (sys.executable, "-m", "steradian")
    command(
        "mask",
        "equi-steradian",
        "--aperture",
        "5mm",
        "--depth",
        "3.6mm",
        "--count",
        "300",
        "-o",
        "m.json",
        cwd=tmp_path,
    )
    command("plan", "m.json", "--pulse-rate", "50Hz", "-o", "p.json", cwd=tmp_path)
    with launch() as scanner:
        scan = subprocess.Popen(
            (*run, "scan", "run", "p.json", "--scanner", scanner.url, "-o", "s.h5"),
            cwd=tmp_path,
            stderr=subprocess.PIPE,
            text=True,
        )
        until(lambda: scanner.send_command("report", fired=False)["shots"] > 20)
        scanner.send_command("interlock", closed=False)
        said = scan.communicate(timeout=200)[1]
        clearing = f"steradian scanner clear-fault --scanner {scanner.url}"
        assert scan.returncode == 5
        for part in ("interlock-opened", "fault 1", clearing):
            assert (part in said) == (part != "fault 1"), said

        refused = command("scanner", "clear-fault", "--scanner", scanner.url)
        assert refused.returncode == 4
        assert "the interlock is open" in refused.stderr
        scanner.send_command("interlock", closed=True)
        resumed = command("scan", "resume", "s.h5", "--scanner", scanner.url, cwd=tmp_path)
        assert resumed.returncode == 5
        assert clearing in resumed.stderr.replace("\n", " ")

        cleared = command("scanner", "clear-fault", "--scanner", scanner.url, "--by", "Ada")
        assert cleared.returncode == 0, cleared.stderr
        assert "Ada cleared the fault interlock-opened" in cleared.stdout
        resumed = command("scan", "resume", "s.h5", "--scanner", scanner.url, cwd=tmp_path)
        assert resumed.returncode == 0, resumed.stderr
