"""A person at a terminal: a scan, Ctrl-C, and going on with it, over a real pseudo-terminal."""

import fcntl
import os
import re
import signal
import subprocess
import sys
import termios
import time

import h5py
import numpy as np
import pytest
import typer

pexpect = pytest.importorskip("pexpect")

from fabry_perot.simulator import launch  # noqa: E402
from steradian.cli.terminal_scan_control import terminal_scan_control  # noqa: E402
from steradian.masks import equi_steradian_mask, grid_mask  # noqa: E402
from steradian.plans import ScanPlan  # noqa: E402
from steradian.plans.files import write_json  # noqa: E402
from steradian.scans.acquisition.run import ScanSummary  # noqa: E402
from steradian.scans.acquisition.session_control import SessionOutcome  # noqa: E402
from steradian.scans.file.stages import read_stages  # noqa: E402

POINTS = 576
ANSWER = r"laser off; ([\d,]+) of 576 stored in scan\.h5 \([^)]*\); go on with: steradian scan resume scan\.h5"
EXACT = {"noise_db": float("inf"), "energy_jitter": 0.0}
"""A simulated scanner whose A-lines depend on the point alone."""
READING = """
import runpy, signal, sys

class Finder:
    def find_spec(self, name, *_):
        if name == "{}":
            sys.meta_path.remove(self)
            print("reading", flush=True)
            signal.pause()

sys.meta_path.insert(0, Finder())
runpy.run_module("steradian", run_name="__main__")
"""
"""The program, which tells when it begins to read a module, and waits there."""

HEARING = """
import signal, sys

def hear(*_):
    print(sorted(name for name in sys.modules if name.split(".")[0] in ("steradian", "socket", "typing")))
    sys.exit()

signal.signal = hear
from steradian.cli import main
main()
"""
"""The program, which tells what it has read when it begins to hear Ctrl-C, and ends."""


def hears():
    """A terminal's job hears Ctrl-C; in the background of a shell, where tests may run, children ignore it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    mask = grid_mask(13.56e-3, 24, 560e-6)
    path = tmp_path_factory.mktemp("plan") / "plan.json"
    write_json(ScanPlan.create(mask=mask, samples=256, order="shortest"), path)
    return path


@pytest.fixture
def terminal(tmp_path):
    """Start ``steradian …`` as the foreground job of a terminal; what it shows is kept in ``transcript``."""
    running = []

    def start(*words):
        screen = {"LINES": "24", "COLUMNS": "100", "TERM": "xterm"}
        process = pexpect.spawn(
            sys.executable,
            ["-m", "steradian", *map(str, words)],
            cwd=str(tmp_path),
            env=os.environ | screen,
            dimensions=(24, 100),
            timeout=250,
            encoding="utf-8",
            preexec_fn=hears,
        )
        running.append(process)
        return process

    yield start
    for process in running:
        process.close(force=True)


def stop_at(process, share=4):
    """Press Ctrl-C once so many hundredths of the A-lines are stored."""
    bar = re.compile(r"A-lines\D[^\r\n]*?(\d+)/576")
    while True:
        process.expect(bar)
        if int(process.match[1]) * 100 >= share * POINTS:
            break
    process.sendcontrol("c")


def read(path):
    """Return samples in units of pressure, and which rows are stored."""
    with h5py.File(path) as file:
        alines = file["alines"]
        return alines["samples"][:] * alines["scale"][:][:, None], alines["status"][:] == 1


@pytest.mark.long
def test_a_scan_is_stopped_by_ctrl_c_and_resumed(plan, terminal, tmp_path):
    """The first Ctrl-C answers with one line, and what that line says to type completes the scan, checked."""
    scan = terminal("scan", "run", plan, "--simulator-speed", "0.4")
    stop_at(scan)
    scan.expect(ANSWER)
    stored = int(scan.match[1].replace(",", ""))
    scan.expect(pexpect.EOF)
    scan.close()
    assert scan.exitstatus == 130
    assert "Traceback" not in scan.before
    assert read(tmp_path / "scan.h5")[1].sum() == stored
    assert 0 < stored < POINTS

    resumed = terminal("scan", "resume", "scan.h5", "--simulator-speed", "50")
    resumed.expect(r"576 of 576 A-lines in scan\.h5 \([\d.]+ [kMG]?B\)")
    resumed.expect(pexpect.EOF)
    resumed.close()
    assert resumed.exitstatus == 0

    check = terminal("scan", "check", "scan.h5")
    check.expect("576 of 576 A-lines intact")
    check.expect(pexpect.EOF)
    check.close()
    assert check.exitstatus == 0


@pytest.mark.long
def test_after_ctrl_c_the_laser_is_off_and_every_shot_is_stored(plan, terminal, tmp_path):
    """The scanner's own account: no shot after the answer, as many fired as stored; the whole is as never stopped."""
    with launch(speed=0.4, seed=3, **EXACT) as simulator:
        scan = terminal("scan", "run", plan, "--scanner", simulator.url)
        stop_at(scan)
        scan.expect(ANSWER)
        then = simulator.send_command("report")
        assert then["state"] == "safe_hold"
        assert then["shots"] == int(scan.match[1].replace(",", ""))
        scan.expect(pexpect.EOF)
        scan.close()
        assert scan.exitstatus == 130
        wait_for(lambda: simulator.send_command("report")["time"] > then["time"] + 1_000_000)
        assert simulator.send_command("report")["shots"] == then["shots"]
    with launch(speed=100.0, seed=3, **EXACT) as simulator:
        for words in (["resume", "scan.h5"], ["run", plan, "--output", "whole.h5"]):
            process = terminal("scan", *words, "--scanner", simulator.url)
            process.expect("576 of 576 A-lines")
            process.expect(pexpect.EOF)
            process.close()
            assert process.exitstatus == 0, process.before
    found, stored = read(tmp_path / "scan.h5")
    expected, _ = read(tmp_path / "whole.h5")
    assert stored.all()
    np.testing.assert_array_equal(found, expected)


@pytest.mark.long
def test_a_second_ctrl_c_leaves_at_once_with_the_file_whole(plan, terminal, tmp_path):
    """Whoever presses Ctrl-C again is not kept waiting, even by a scanner that has gone silent; nothing is damaged."""
    with launch(speed=1.0, seed=3) as simulator:
        scan = terminal("scan", "run", plan, "--scanner", simulator.url)
        bar = re.compile(r"A-lines\D[^\r\n]*?(\d+)/576")
        scan.expect(bar)
        simulator.send_command("stall", way="up", seconds=1000)
        simulator.send_command("stall", way="down", seconds=1000)
        scan.sendcontrol("c")
        scan.expect("not confirmed")
        scan.sendcontrol("c")
        scan.expect("leaving at once")
        scan.expect(pexpect.EOF)
        scan.close()
        assert scan.exitstatus == 130
        wait_for(lambda: simulator.send_command("report")["state"] == "safe_hold")  # its lease has run out
    check = terminal("scan", "check", "scan.h5", "--no-repair")
    check.expect("A-lines intact")
    check.expect(pexpect.EOF)
    check.close()
    assert check.exitstatus == 0


@pytest.mark.long
@pytest.mark.parametrize("way", ["signal alone", "terminal goes", "terminal goes with standard error"])
def test_scan_run_after_sighup_ends_as_after_ctrl_c(plan, terminal, tmp_path, way):
    """As when an ssh connection is closed; words on a terminal that is gone are lost, those in a file are not."""
    with launch(speed=0.4, seed=3) as simulator:
        command = [sys.executable, "-m", "steradian", "scan", "run", str(plan), "--scanner", simulator.url]
        master, slave = os.openpty()
        with (tmp_path / "said").open("wb") as said:
            errors = slave if way == "terminal goes with standard error" else said
            about = {"stdin": slave, "stdout": slave, "stderr": errors, "start_new_session": True, "preexec_fn": own}
            scan = subprocess.Popen(command, cwd=tmp_path, **about)
        os.close(slave)
        wait_for(lambda: simulator.send_command("report")["shots"] > 100)
        if way == "signal alone":
            scan.send_signal(signal.SIGHUP)
            scan.send_signal(signal.SIGHUP)
        else:
            os.close(master)  # the system sends SIGHUP to the terminal's session
        assert scan.wait(250) == 130
        report, stored = simulator.send_command("report"), int(read(tmp_path / "scan.h5")[1].sum())
        assert (report["state"], report["shots"]) == ("safe_hold", stored)
        found = re.search(ANSWER, (tmp_path / "said").read_text())
        assert found or errors == slave, (tmp_path / "said").read_text()
        if way == "signal alone":
            os.close(master)


def own():
    """Make the terminal that of the new session, which hears of its end, though it be ``nohup`` that runs the tests."""
    hears()
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


@pytest.mark.parametrize("module", ["steradian.cli.app", "typer", "steradian.cli.plan", "typer.rich_utils"])
def test_ctrl_c_while_the_program_is_still_being_read_is_one_line(module):
    """It takes some seconds on a busy machine until a command has all its libraries; whichever is read, one line."""
    code = READING.format(module)
    process = subprocess.Popen(
        [sys.executable, "-c", code, "plan", "--help"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=hears,
    )
    assert process.stdout.readline() == "reading\n"
    process.send_signal(signal.SIGINT)
    shown, said = process.communicate(timeout=250)
    assert (process.returncode, shown, said) == (130, "", "error: stopped\n")


def test_ctrl_c_is_heard_before_anything_else_is_read():
    """What Python itself reads before the program begins is all that is left to interrupt with a traceback."""
    counted = {name for name in os.environ if name.startswith("COVERAGE_")}  # what counts lines reads more, and earlier
    only = {name: value for name, value in os.environ.items() if name not in counted}
    read = subprocess.run([sys.executable, "-c", HEARING], capture_output=True, text=True, preexec_fn=hears, env=only)
    first = ["steradian", "steradian._display_loaders", "steradian._version", "steradian.cli"]
    assert read.stdout == f"{first}\n", read.stderr


def test_connection_that_ends_by_request_before_there_is_a_file_is_a_stop_before_the_scan(tmp_path, capsys):
    """A session that ends by the request, and not by the exception of Ctrl-C, has the same answer."""
    file = tmp_path / "scan.h5"
    with terminal_scan_control(file) as control:
        with pytest.raises(KeyboardInterrupt):
            control.on_signal(signal.SIGINT, None)
        with pytest.raises(typer.Exit) as ended:
            control.end(ScanSummary(file, points=POINTS, fired=0, stored=0, end=SessionOutcome.STOPPED))
    assert ended.value.exit_code == 130
    assert capsys.readouterr().err.strip() == "stopped before the scan began; nothing is written"


@pytest.mark.long
def test_ctrl_c_before_the_scan_begins_leaves_nothing_behind(plan, terminal, tmp_path):
    """While the scanner does not answer yet, Ctrl-C ends the command, which says that nothing was measured."""
    with launch(speed=1.0, tcp="127.0.0.1:0") as simulator:
        simulator.send_command("cut", way="up", seconds=1000)
        scan = terminal("scan", "run", plan, "--scanner", simulator.url)
        scan.expect("connecting")
        scan.sendcontrol("c")
        scan.expect("stopped before the scan began; nothing is written")
        scan.expect(pexpect.EOF)
        scan.close()
        assert scan.exitstatus == 130
    assert not (tmp_path / "scan.h5").exists()


def wait_for(condition):
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def scan_that_asks(terminal, tmp_path):
    """A scan whose survey of 24 points is measured, and which waits for a point of interest."""
    mask = equi_steradian_mask(13.56e-3, 3.6e-3, 60)
    write_json(ScanPlan.create(mask=mask, samples=384), tmp_path / "plan.json")
    scan = terminal("scan", "run", "plan.json", "--survey", "24", "--focus", "ask", "--simulator-speed", "50")
    scan.expect("laser off; choose: numbers such as 1")
    return scan


@pytest.mark.long
def test_a_person_chooses_the_point_of_interest_at_the_terminal(terminal, tmp_path):
    scan = scan_that_asks(terminal, tmp_path)
    scan.sendline("here")
    scan.expect("choice is here; allowed: numbers such as 1 or 1,2")
    scan.sendline("2mm,-1.5mm,2.5mm")
    scan.expect("53 of 53 A-lines")
    scan.expect(pexpect.EOF)
    scan.close()
    assert scan.exitstatus == 0
    chosen = read_stages(tmp_path / "scan.h5")[1]
    assert (chosen.decided_by, chosen.points_of_interest) == ("terminal", ((2e-3, -1.5e-3, 2.5e-3),))


@pytest.mark.long
def test_ctrl_c_ends_a_scan_that_waits_for_a_choice(terminal, tmp_path):
    scan = scan_that_asks(terminal, tmp_path)
    scan.sendcontrol("c")
    scan.expect("24 of 24 stored in scan.h5")
    scan.expect(pexpect.EOF)
    scan.close()
    assert scan.exitstatus == 130
