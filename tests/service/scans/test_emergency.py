"""The acquisition's hold on the laser while the emergency stop stands, and what is said of it afterwards."""

import threading
import time
from contextlib import contextmanager

import pytest

from fabry_perot.simulator import launch
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.scans.acquisition.emergency_watchdog import EmergencyWatchdog
from steradian.scans.acquisition.run import run_scan
from steradian.scans.acquisition.session_control import Command, SessionControl, SessionOutcome
from steradian.storage.data_dir.emergency_latch import EmergencyLatch, StopOutcome


@pytest.fixture(scope="module")
def plan():
    mask = equi_steradian_mask(aperture=13.56e-3, depth=3.6e-3, count=60)
    return ScanPlan.create(mask=mask, samples=256, pulse_rate=100.0)


class CountedLatch(EmergencyLatch):
    """Tells how often it was looked at, and cannot be looked at a first few times."""

    def __init__(self, folder, failures=0):
        super().__init__(folder)
        self.looks, self.failures = 0, failures

    def active(self):
        self.looks += 1
        if self.looks <= self.failures:
            raise RuntimeError("whatever it was")
        return super().active()

    def until(self, looks):
        deadline = time.monotonic() + 60
        while self.looks < looks:
            assert time.monotonic() < deadline
            threading.Event().wait(0.005)


def test_recorded_stop_outcome_is_kept_after_acquisition_restart(tmp_path):
    """The laser was switched off; that nothing runs after the restart is no answer to that press."""
    latch = CountedLatch(tmp_path)
    press = latch.press("Ada", "smoke")
    latch.record_outcome(StopOutcome(press.number, "off", 0.012))
    with EmergencyWatchdog(latch).running():
        latch.until(5)
    assert latch.outcome(press.number) == StopOutcome(press.number, "off", 0.012)


def test_watchdog_continues_polling_after_failed_latch_read(tmp_path):
    latch = CountedLatch(tmp_path, failures=3)
    press = latch.press("Ada", "smoke")
    with EmergencyWatchdog(latch).running():
        latch.until(6)
    assert latch.outcome(press.number).laser == "idle"


def test_session_monitor_exits_only_after_shutter_is_closed(plan, tmp_path):
    """A session that fails leaves a firing laser to the end of its connection, which switches it off."""

    class Fails(SessionControl):
        @contextmanager
        def monitor(self, scanner):
            try:
                yield
            finally:
                shutters.append(simulator.send_command("report")["shutter"])

        def progress(self, done, total):
            shutters.append(simulator.send_command("report")["shutter"])
            raise RuntimeError("a fault of our own")

    shutters = []
    with launch(speed=1.0) as simulator, pytest.raises(RuntimeError, match="our own"):
        run_scan(plan, simulator.url, tmp_path / "a.h5", control=Fails())
    assert shutters == [True, False]


def test_abort_while_laser_is_armed_ends_scan_before_first_shot(plan, tmp_path):
    class Hesitates(SessionControl):
        """Wants the scan to end, but only while the laser is armed."""

        @contextmanager
        def monitor(self, scanner):
            self.scanner = scanner
            yield

        def command(self):
            return Command.ABORT if self.scanner.state == "armed" else Command.RUN

    with launch(speed=20.0) as simulator:
        summary = run_scan(plan, simulator.url, tmp_path / "a.h5", control=Hesitates())
        assert (summary.end, simulator.send_command("report")["shots"]) == (SessionOutcome.ABORTED, 0)
