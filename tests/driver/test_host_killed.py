"""A host killed with -9 in mid-scan: the laser goes off by itself, and another process takes the scan up exactly."""

from __future__ import annotations

import subprocess
import sys
import time

import numpy as np
import pytest
from driver_collected import collect

import fabry_perot
from fabry_perot.simulator import launch
from fabry_perot.wire.states import HoldCause

HOST = """
import sys, numpy as np, fabry_perot
url, count = sys.argv[1], int(sys.argv[2])
where = np.random.default_rng(0).uniform(-6e-3, 6e-3, (count, 2)).round(6)
scanner = fabry_perot.connect(url)
scanner.upload(where, samples=600, sampling_interval=8e-9, pulse_rate=200.0)
scanner.start(scanner.arm())
while True:
    try:
        for batch in scanner.alines():
            scanner.acknowledge(batch[-1])
            print(batch[-1].number, flush=True)
        break
    except fabry_perot.LeaseExpired:
        scanner.resume()
"""


def kill_a_host_in_mid_scan(simulator, count: int) -> tuple[int, int, int]:
    """Return the time when a host was dead, the last A-line it acknowledged, and the shots fired before it came.

    A busy machine may give the host its A-lines, or this test its turn, so late that the scan is (all but) over by
    then: that is no killing in mid-scan, and done again.
    """
    for _ in range(20):
        before = simulator.send_command("drift", pm=0)["shots"]
        host = subprocess.Popen([sys.executable, "-c", HOST, simulator.url, str(count)], stdout=subprocess.PIPE)
        number = 0
        for line in host.stdout:
            number = int(line)
            if number >= 20:
                break
        host.kill()
        dead = simulator.send_command("drift", pm=0)
        number = max([number, *map(int, host.stdout)])
        host.wait()
        host.stdout.close()
        if dead["state"] == "scanning" and dead["shots"] - before < count - 120:  # half a second has pulses for 100
            return dead["time"], number, before
    raise AssertionError("the scan was always over first")


def wait_for(simulator, device_time: int) -> None:
    """Bounded wait for the simulator's own time."""
    for _ in range(3000):
        if simulator.send_command("drift", pm=0)["time"] > device_time:
            return
        time.sleep(0.02)
    raise AssertionError("the simulator stands still")


@pytest.mark.long
def test_kill_9_of_the_host_turns_the_laser_off_within_500_ms_and_the_scan_can_be_resumed_exactly():
    count = 300
    where = np.random.default_rng(0).uniform(-6e-3, 6e-3, (count, 2)).round(6)
    with launch() as simulator:
        dead, last, before = kill_a_host_in_mid_scan(simulator, count)
        wait_for(simulator, dead + 700_000)
        with fabry_perot.connect(simulator.url) as scanner:
            status = scanner.statistics()
            assert scanner.state == "safe_hold"
            assert status["cause"] == HoldCause.LEASE, "off by the lease itself, not by the new session"
            assert status["last_shot"] < status["lease_until"]
            assert status["lease_until"] < dead + 500_000
            assert scanner.statistics()["shots"] == status["shots"], "and it stays off"

            scanner.upload(where, samples=600, sampling_interval=8e-9, pulse_rate=200.0, resume=True)
            scanner.start(scanner.arm())
            lines = collect(scanner)
            assert lines[0].number <= last + 1
            assert [line.number for line in lines] == list(range(lines[0].number, count))
            assert scanner.statistics()["shots"] == before + count, "no point was fired twice"
