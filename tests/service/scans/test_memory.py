"""A scan as dense as scanners make them needs little memory, in every process that has to do with it."""

import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fabry_perot.simulator import launch
from steradian.masks import grid_mask
from steradian.plans import ScanPlan
from steradian.plans.files import write_json
from steradian.scans.file.verify import verify_scan_file

GIB = 2**30


def peak(pid):
    """Largest resident memory of a process so far, in bytes; 0 when it is over."""
    try:
        found = re.search(r"VmHWM:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text())
    except OSError:
        return 0
    return int(found[1]) * 1024 if found else 0


@pytest.mark.soak
@pytest.mark.timeout(900)
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="peaks of memory are read from /proc")
def test_a_scan_of_51076_points_and_2048_samples_stays_under_a_gibibyte(tmp_path, capsys):
    mask = grid_mask(aperture=13.56e-3, count=226, interval=60e-6)
    plan = ScanPlan.create(mask=mask, samples=2048, pulse_rate=2_000.0)
    assert plan.mask.count == 51_076
    write_json(plan, tmp_path / "plan.json")
    peaks = {"simulator": 0, "scan": 0, "check": 0}
    begin = time.monotonic()
    with launch(speed=20.0, repeat=64, ring=4096, link=str(tmp_path / "port")) as simulator:
        command = [sys.executable, "-m", "steradian", "scan", tmp_path / "plan.json", "--scanner", simulator.url]
        process = subprocess.Popen([*command, "--output", tmp_path / "scan.h5"])
        while process.poll() is None:
            peaks["scan"] = max(peaks["scan"], peak(process.pid))
            peaks["simulator"] = max(peaks["simulator"], peak(simulator.pid))
            time.sleep(0.1)
    assert process.returncode == 0
    seconds = time.monotonic() - begin
    process = subprocess.Popen([sys.executable, "-m", "steradian", "scan", "check", tmp_path / "scan.h5"])
    while process.poll() is None:
        peaks["check"] = max(peaks["check"], peak(process.pid))
        time.sleep(0.02)
    report = verify_scan_file(tmp_path / "scan.h5", repair=False)
    with capsys.disabled():
        sizes = ", ".join(f"{name} {value / 2**20:.0f} MiB" for name, value in peaks.items())
        print(f"\n  51,076 × 2,048 in {seconds:.0f} s; peaks: {sizes}")
    assert report.is_consistent
    assert report.intact == 51_076
    assert all(0 < value < GIB for value in peaks.values()), peaks
