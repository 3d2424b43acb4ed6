"""What a session and the database tell each other never holds up the A-lines."""

import sqlite3
import threading
import time
from contextlib import contextmanager

import h5py
import numpy as np
import pytest

from fabry_perot.simulator import launch
from steradian.core.exceptions import ScanFailed
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.scans.acquisition.database_control import DatabaseControl
from steradian.scans.acquisition.emergency_watchdog import EmergencyWatchdog
from steradian.scans.acquisition.run import run_scan
from steradian.scans.acquisition.session_control import Command, SessionOutcome, SessionPhase
from steradian.storage.data_dir.emergency_latch import EmergencyLatch
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database
from steradian.storage.repositories.masks import MaskRepository
from steradian.storage.repositories.plans import PlanRepository
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import DesiredScanState, ScanState

RATE = 50.0


class Desk:
    """A database with a scan that is being armed, and its watch."""

    def __init__(self, folder):
        self.data = DataDirectory(folder)
        self.data.create()
        self.database = Database(self.data.metadata_url)
        self.database.migrate()
        self.scans = ScanRepository(self.database)
        mask = equi_steradian_mask(aperture=13.56e-3, depth=3.6e-3, count=60)
        self.plan = ScanPlan.create(mask=mask, samples=256, pulse_rate=RATE)
        MaskRepository(self.database).put(mask)
        row = PlanRepository(self.database).put(self.plan)[0]
        self.id = self.scans.queue(row, simulated=True).id
        self.scans.transition(self.id, ScanState.ARMING, why="test")
        self.stopping = threading.Event()

    def watch(self, kind=DatabaseControl):
        return kind(self.scans, self.id, self.stopping, EmergencyWatchdog(EmergencyLatch(self.data.emergency)))

    @contextmanager
    def locked(self):
        """Nobody else writes to the database until the block ends."""
        connection = sqlite3.connect(self.database.engine.url.database, isolation_level=None)
        connection.execute("BEGIN IMMEDIATE")
        try:
            yield
        finally:
            connection.rollback()
            connection.close()

    @property
    def row(self):
        return self.scans.get(self.id)

    def until(self, condition):
        deadline = time.monotonic() + 60
        while not condition():
            assert time.monotonic() < deadline, self.row.history
            threading.Event().wait(0.01)


@pytest.fixture
def desk(tmp_path):
    desk = Desk(tmp_path)
    yield desk
    desk.database.close()


@pytest.mark.long
def test_a_locked_database_takes_nothing_from_the_rate_of_a_lines(desk, tmp_path):
    """By the scanner's clock: the laser fires on, a shot every 20 ms, while the database is locked; later it learns."""
    lock = desk.locked()

    class Locks(DatabaseControl):
        locked = False

        def progress(self, done, total):
            if done >= 10 and not self.locked:
                self.locked = True
                lock.__enter__()
            super().progress(done, total)

    watch, path = desk.watch(Locks), tmp_path / "scan.h5"
    try:
        with launch(speed=1.0) as simulator:
            summary = run_scan(desk.plan, simulator.url, path, control=watch)
        assert (summary.end, summary.stored) == (SessionOutcome.COMPLETE, desk.plan.mask.count)
        assert desk.row.done < summary.stored, "the database was locked all the time"
    finally:
        lock.__exit__(None, None, None)
    with h5py.File(path) as file:
        fired = np.sort(file["alines/fire_time_s"][:])
    assert np.diff(fired) == pytest.approx(1 / RATE, rel=0.01), "not a pulse was left out"
    watch.flush()
    assert (desk.row.done, desk.row.state) == (summary.stored, ScanState.RUNNING)


def test_watch_records_phases_in_order_after_database_lock(desk):
    watch = desk.watch()
    with desk.locked():
        for phase in (
            SessionPhase.RUNNING,
            SessionPhase.RECOVERING,
            SessionPhase.RUNNING,
            SessionPhase.PAUSING,
            SessionPhase.PAUSED,
        ):
            watch.on_phase(phase)
        watch.on_storage_blocked("the disk is full")
        watch.progress(7, 60)
        assert watch.command() is Command.RUN
        assert desk.row.state is ScanState.ARMING
    watch.flush()
    states = [entry["state"] for entry in desk.row.history]
    assert states == ["queued", "arming", "running", "recovering", "running", "pausing", "paused"]
    assert (desk.row.stage, desk.row.done) == ("A-lines", 7)


def test_watch_command_follows_desired_state_and_keeps_last_after_close(desk):
    desk.scans.set_desired_state(desk.id, DesiredScanState.PAUSED, "let me see")
    watch = desk.watch()
    assert watch.command() is Command.PAUSE, "at once, before anything is fired"
    desk.scans.set_desired_state(desk.id, DesiredScanState.RUNNING, "go on")
    desk.until(lambda: watch.command() is Command.RUN)
    desk.scans.set_desired_state(desk.id, DesiredScanState.STOPPED, "enough")
    desk.until(lambda: watch.command() is Command.STOP)
    watch.close()
    assert watch.command() is Command.STOP


def test_watch_with_unexpected_poll_error_fails_scan(desk, monkeypatch):
    """A thread that ended unseen would leave the scan running, whatever is wished."""
    watch = desk.watch()
    assert watch.command() is Command.RUN

    def surprise(identifier):
        raise RuntimeError("another row than any before")

    monkeypatch.setattr(desk.scans, "get", surprise)
    desk.until(lambda: watch._failure is not None)
    with pytest.raises(ScanFailed, match="another row than any before"):
        watch.command()
    watch.close()
