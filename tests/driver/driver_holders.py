"""Other programs that hold a scanner's port: `fabry-perot scan`, and one without our driver."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from fabry_perot.simulator import Simulator
from support.copies import Popen
from support.waiting import until

FAST = {"speed": 1.0, "noise_db": 60.0}
FOREIGN = """
    import fcntl, os, sys, termios, time
    file = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
    fcntl.flock(file, fcntl.LOCK_EX)
    print("held", flush=True)
    time.sleep(1000)
"""
"""A program that locks the terminal, as most do, and has no control socket."""
ANOTHER_USER = """
    import json, os, sys
    import fabry_perot
    os.setgid(65534)
    os.setgroups([])
    os.setuid(65534)
    print(json.dumps({name: getattr(answer, name) for name in ("laser", "detail", "holder")
                      for answer in [fabry_perot.emergency_stop(sys.argv[1], timeout=10.0, who="guest")]}))
"""
"""A program of a user who may not open the port, which sends an emergency stop."""
LIAR = """
    import sys, time
    from fabry_perot.host.stop_and_status_results import StopAnswer
    from fabry_perot.host.control_server import ControlServer

    class Liar:
        def stop(self, who, timeout):
            return StopAnswer("off", "safe_hold", "closed", "", "all is well", 0.0)

        def port_status(self):
            return None

        def give_way(self):
            return False

    server = ControlServer(Liar(), sys.argv[1])
    print("lying", flush=True)
    time.sleep(1000)
"""
"""A program that claims to hold the port, and that the laser is off."""


def report(simulator: Simulator) -> dict:
    """The simulator's own account: its clock (µs), shots, time of the last one (µs), state, shutter open or not."""
    return simulator.send_command("report", fired=False)


@contextmanager
def program(code: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Run Python code in a process of its own."""
    command = [sys.executable, "-c", textwrap.dedent(code), *arguments]
    with Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


@contextmanager
def scan_of(simulator: Simulator, folder: Path, points: int = 5000) -> Iterator[subprocess.Popen[str]]:
    """Run `fabry-perot scan` in a process of its own, and go on once it has fired twenty times."""
    where = np.random.default_rng(0).uniform(-6, 6, (points, 2)).round(3)
    np.savetxt(folder / "points.csv", where, delimiter=",", header="x_mm,y_mm", comments="", fmt="%.4f")
    words = ["scan", simulator.url, "points.csv", "--samples", "64", "--rate", "100"]
    command = [sys.executable, "-m", "fabry_perot", *words]
    before = report(simulator)["shots"]
    with Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            until(lambda: report(simulator)["shots"] > before + 20, tell=lambda: f"(code {process.poll()})")
            yield process
        finally:
            process.send_signal(signal.SIGCONT)  # nothing where it has ended
            process.kill()
