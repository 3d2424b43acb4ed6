"""The acquisition's work while the disk is full, or will be."""

import errno
import shutil
import sys
import threading
import time
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from acquisition_bench import Bench, Port

from fabry_perot import RecoveryPolicy
from fabry_perot.simulator import launch
from steradian.runtime.acquisition import count_alines
from steradian.scans.file.create import scan_file_bytes
from steradian.scans.file.writer import ScanFileWriter
from steradian.storage.state_machines import DesiredScanState, ScanState

S, W = ScanState, DesiredScanState


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    bench = Bench(tmp_path_factory.mktemp("acquisition"))
    yield bench
    bench.close()


@pytest.fixture
def full(monkeypatch):
    """The disk is full while this is set; a session looks again soon."""
    full, overwrite = threading.Event(), ScanFileWriter._overwrite

    def write(store, offset, data):
        if full.is_set():
            raise OSError(errno.ENOSPC, "No space left on device")
        overwrite(store, offset, data)

    monkeypatch.setattr(ScanFileWriter, "_overwrite", write)
    monkeypatch.setattr("steradian.scans.acquisition.session.RETRY_INTERVAL", 0.05)
    return full


def until_blocked(bench, identifier):
    deadline = time.monotonic() + 60
    while not (bench.scans.get(identifier).stage or "").startswith("blocked"):
        assert time.monotonic() < deadline
        threading.Event().wait(0.01)


def test_full_disk_pauses_laser_and_scan_stage_reports_it(bench, full):
    identifier = bench.queue(pulse_rate=5.0)
    stages, stored = [], []

    def act():
        bench.until(identifier, S.RUNNING)
        full.set()
        until_blocked(bench, identifier)
        stored.append(count_alines(bench.data.scan_file(identifier))["stored"])
        threading.Event().wait(0.4)
        stages.append(bench.scans.get(identifier))
        stored.append(count_alines(bench.data.scan_file(identifier))["stored"])
        full.clear()

    bench.meanwhile(act)
    assert stages[0].state is S.RUNNING
    assert "disk" in stages[0].stage
    assert stored[0] == stored[1] < 53
    row = bench.scans.get(identifier)
    assert (row.state, row.stage) == (S.COMPLETE, "A-lines")
    assert row.summary == {"points": 53, "stored": 53, "fired": 53}


@pytest.mark.long
def test_scan_blocked_too_long_by_full_disk_resumes_only_on_request(tmp_path, full):
    """Everything that was fired before is stored once there is room."""
    bench = Bench(tmp_path, within=0.0)
    identifier = bench.queue(pulse_rate=5.0)

    def act():
        bench.until(identifier, S.RUNNING)
        full.set()
        until_blocked(bench, identifier)
        full.clear()

    bench.meanwhile(act)
    row = bench.scans.get(identifier)
    assert (row.state, row.desired_state, row.error_code) == (S.INTERRUPTED, W.PAUSED, "scan-interrupted")
    assert row.summary["fired"] == row.summary["stored"] < 53
    bench.work._recovery = RecoveryPolicy(within=60.0)
    bench.scans.set_desired_state(identifier, W.RUNNING, None)
    bench.work.run_once()
    assert bench.scans.get(identifier).state is S.COMPLETE
    bench.close()


@pytest.mark.long
def test_interlock_opened_during_full_disk_interrupts_scan_until_resumed(tmp_path, full):
    """Somebody has opened the enclosure meanwhile, so a person decides, however soon there is room again."""
    with launch(speed=50.0) as simulator:
        bench = Bench(tmp_path, Port(simulator.url))
        identifier = bench.queue(pulse_rate=5.0)

        def act():
            bench.until(identifier, S.RUNNING)
            full.set()
            until_blocked(bench, identifier)
            simulator.send_command("interlock", closed=False)
            threading.Event().wait(0.1)  # time enough for the device to see it, at whatever speed
            simulator.send_command("interlock", closed=True)
            full.clear()

        bench.meanwhile(act)
        row = bench.scans.get(identifier)
        assert (row.state, row.desired_state, row.error_code) == (S.INTERRUPTED, W.PAUSED, "scan-interrupted")
        assert row.summary["fired"] == row.summary["stored"] < 53
        bench.scans.set_desired_state(identifier, W.RUNNING, None)
        bench.work.run_once()
        assert bench.scans.get(identifier).state is S.COMPLETE
        bench.close()


def test_a_scan_that_cannot_fit_fails_before_a_pulse(bench, monkeypatch):
    usage = shutil.disk_usage(bench.data.root)._replace(free=1000)
    monkeypatch.setattr("steradian.scans.file.create.shutil.disk_usage", lambda folder: usage)
    identifier = bench.queue()
    bench.work.run_once()
    row = bench.scans.get(identifier)
    assert (row.state, row.error_code) == (S.FAILED, "disk-full")
    assert "0.0 MB free" in row.error
    assert not bench.data.scan_file(identifier).exists()


def test_a_disk_that_will_be_nearly_full_is_a_warning_and_no_obstacle(bench, monkeypatch):
    identifier = bench.queue()
    plan = bench.plans.load(bench.scans.get(identifier).plan_id)
    usage = shutil.disk_usage(bench.data.root)._replace(free=scan_file_bytes(plan) + 1)
    monkeypatch.setattr("steradian.scans.file.create.shutil.disk_usage", lambda folder: usage)
    bench.work.run_once()
    row = bench.scans.get(identifier)
    assert row.state is S.COMPLETE
    assert "MB free" in row.history[1]["why"]
