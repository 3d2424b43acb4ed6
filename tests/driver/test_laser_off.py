"""The laser goes off when the host's process ends, whatever its buffered bytes do later: real processes, device time.

The simulator says when the host's bytes began to be held and when it fired, so no clock of this machine is involved.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from fabry_perot.simulator import launch

HOST = """
import sys, numpy as np, fabry_perot
where = np.random.default_rng(0).uniform(-6e-3, 6e-3, (3000, 2)).round(6)
scanner = fabry_perot.connect(sys.argv[1], recovery=None)
scanner.upload(where, samples=64, sampling_interval=8e-9, pulse_rate=100.0)
scanner.start(scanner.arm())
while True:
    try:
        for batch in scanner.alines():
            scanner.acknowledge(batch[-1])
            print(batch[-1].number, flush=True)
        break
    except fabry_perot.LeaseExpired:  # a busy machine
        scanner.resume()
"""
TTL = 500_000
ENDS = ("kill", "stop", "unplug")


def experiment(end: str, link: str, *, stalled: bool) -> tuple[dict, dict, dict]:
    """End a host in mid-scan; return the simulator's state when its bytes began to be held, then, and in the end."""
    with launch(ring=4000, link=link) as simulator:
        host = subprocess.Popen([sys.executable, "-c", HOST, simulator.url], stdout=subprocess.PIPE)
        try:
            for _ in range(20):
                assert host.stdout.readline()
            before = (
                simulator.send_command("stall", way="up", seconds=3.0) if stalled else simulator.send_command("report")
            )
            if stalled:
                time.sleep(0.15)  # the host's leases go on into the buffer
            if end == "unplug":
                simulator.send_command("unplug", seconds=1.0)
            else:
                host.send_signal(signal.SIGKILL if end == "kill" else signal.SIGSTOP)
            ended = simulator.send_command("report")
            wait_for(simulator, ended["time"] + (3_500_000 if stalled else 1_000_000))
            return before, ended, simulator.send_command("report")
        finally:
            host.kill()
            host.stdout.close()
            host.wait()


def wait_for(simulator, device_time: int) -> None:
    """Bounded wait for the simulator's own time."""
    for _ in range(3000):
        if simulator.send_command("drift", pm=0)["time"] >= device_time:
            return
        time.sleep(0.02)
    raise AssertionError("the simulator stands still")


@pytest.fixture(scope="module")
def experiments(tmp_path_factory):
    """All six at the same time, since each mostly waits."""
    folder = tmp_path_factory.mktemp("links")
    with ThreadPoolExecutor(6) as pool:
        running = {
            (end, stalled): pool.submit(experiment, end, str(folder / f"{end}{stalled}"), stalled=stalled)
            for end in ENDS
            for stalled in (False, True)
        }
        return {key: future.result() for key, future in running.items()}


@pytest.mark.parametrize("end", ENDS)
def test_the_laser_is_off_within_500_ms_of_the_hosts_end(experiments, end):
    _, ended, last = experiments[end, False]
    assert last["state"] == "safe_hold"
    assert last["last_shot"] < ended["time"] + TTL


@pytest.mark.parametrize("end", ENDS)
def test_bytes_held_for_3_s_and_released_after_the_hosts_end_fire_nothing(experiments, end):
    held, _, last = experiments[end, True]
    assert held["state"] == "scanning"
    assert last["state"] == "safe_hold"
    assert last["last_shot"] < held["time"] + TTL
    assert last["time"] > held["time"] + 3_000_000, "the held bytes were released"
