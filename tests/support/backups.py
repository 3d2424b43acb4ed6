"""A data folder of which backups are made, and what is compared of it."""

import copy
import os
import shutil

import numpy as np
from sqlalchemy import select

from steradian.core.settings import Settings
from steradian.jobs.job import JobRequest
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.plans import ScanPlan
from steradian.runtime.backups import create_backup, restore
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.security.keys import KeyStore, Scope
from steradian.storage.data_dir.emergency_latch import EmergencyLatch
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.tables import Base
from steradian.storage.repositories.plans import PlanRepository
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import ScanState
from support.alines import Aline
from support.kept import Kept

LONG = 1 << 16
"""Samples of an A-line, so that nine of them are more than is copied at a time."""


class Whole(Kept):
    """A kept folder with an upload, a key, and a job that waits, and backups of it."""

    def __init__(self, folder):
        super().__init__(folder)
        database = self.database()
        self.key = KeyStore(database).create("ada", [Scope.ADMIN])
        self.data.upload("u1").write_bytes(b"recorded" * 1000)
        with database.write() as session:
            JobLedger(database).add(session, JobRequest("waits", "import", {"upload_id": "u1"}))
        database.close()
        EmergencyLatch(self.data.emergency).press("ada", "smoke")
        self.serve()  # binds folder and database

    def at(self, folder):
        """The same in another folder."""
        shutil.copytree(self.folder, folder)
        other = copy.copy(self)
        other.settings = Settings.create(data=folder)
        other.folder, other.data, other.file = folder, DataDirectory(folder), folder / "steradian.sqlite"
        return other

    def back_up(self, to, **how):
        database = self.database()
        try:
            return create_backup(self.data, database, to, **how)
        finally:
            database.close()

    def running_scan(self):
        """A scan under way, all of whose 9 A-lines are stored."""
        database = self.database()
        scans = ScanRepository(database)
        plan = ScanPlan.create(mask=self.plan.mask, samples=LONG)
        row, _ = PlanRepository(database).put(plan)
        scan = scans.queue(row, simulated=True).id
        for state in (ScanState.ARMING, ScanState.RUNNING):
            scans.transition(scan, state, why="test")
        database.close()
        create_scan_file(self.data.scan_file(scan), plan, scan_id=scan, simulated=True)
        with ScanFileWriter(self.data.scan_file(scan)) as store:
            store.append([aline(point) for point in range(9)])
        return scan


def aline(point):
    return Aline(point, np.full(LONG, 100 + point, np.int16), point + 1)


def spoil(store, row):
    """Overwrite the samples of a row as somebody who measures it again does halfway."""
    chunk, within = divmod(row, store._chunk_rows)
    os.pwrite(store._handle, b"\x55" * 64, store._chunks[chunk] + 2 * LONG * within)


def rows(database):
    """Everything in the tables, but for what tells two databases apart."""
    with database.read() as session:
        found = {
            table.name: session.execute(select(table).order_by(*table.primary_key)).mappings().all()
            for table in Base.metadata.sorted_tables
        }
    found["event_log"] = {row["name"]: row["value"] for row in found["event_log"]}
    return found | {"event_log": found["event_log"].keys()}, found["event_log"]


def files(folder):
    kinds = ("scans", "jobs", "uploads", "emergency-stop")
    paths = [path for kind in kinds for path in (folder / kind).rglob("*") if path.is_file() and path.name != "lock"]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def restored(backup, folder, url=None):
    settings = Settings.create(data=folder, database_url=url)
    assert restore(backup, settings) == []
    return settings


def once(deed):
    """A deed that is done when the first bytes are copied."""
    done = []

    def progress(*_):
        if not done:
            done.append(deed)
            deed()

    return progress
