"""What a service leaves in its data folder, made without one."""

import threading

import h5py

from steradian.core.settings import Settings
from steradian.jobs.job import JobRequest, Succeeded
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.masks import grid_mask
from steradian.plans import ScanPlan
from steradian.runtime.fsck import check_consistency
from steradian.runtime.supervisor import run_service
from steradian.scans.file.writer import create_scan_file
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.repositories.masks import MaskRepository
from steradian.storage.repositories.plans import PlanRepository
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import ScanState


class Kept:
    """A data folder with a complete scan and two finished reconstructions, without a running service."""

    def __init__(self, folder):
        self.settings = Settings.create(data=folder)
        self.folder, self.data = folder, DataDirectory(folder)
        self.data.create()
        self.file = folder / "steradian.sqlite"
        database = Database(metadata_url(self.settings))
        database.migrate()
        plan = ScanPlan.create(mask=grid_mask(0.01, 3, 1e-3), samples=64)
        MaskRepository(database).put(plan.mask)
        row, _ = PlanRepository(database).put(plan)
        scans, self.plan = ScanRepository(database), plan
        self.scan = scans.queue(row, simulated=True).id
        for state in (ScanState.ARMING, ScanState.RUNNING, ScanState.COMPLETING, ScanState.COMPLETE):
            scans.transition(self.scan, state, why="test", summary={"points": 9, "stored": 9, "fired": 9})
        create_scan_file(self.data.scan_file(self.scan), plan, scan_id=self.scan, simulated=True)
        with h5py.File(self.data.scan_file(self.scan), "r+") as file:
            file["alines/status"][:] = 1
        ledger = JobLedger(database)
        for name in ("first", "second"):
            with database.write() as session:
                ledger.add(session, JobRequest(name, "reconstruction", {"scan_id": self.scan}))
            self.finish(ledger, ledger.start_attempt(name, "worker-0"))
            self.data.job(name).root.mkdir()
            self.data.job(name).volume.write_bytes(b"values")
        database.close()

    @staticmethod
    def finish(ledger, row):
        ledger.finish_attempt(row.id, row.fence, Succeeded({"shape": [1, 1, 1]}), "worker-0")

    def database(self):
        return Database(metadata_url(self.settings))

    def serve(self):
        """Start a service that is asked to end at once; what refuses a folder comes before."""
        stop = threading.Event()
        stop.set()
        run_service(self.settings.model_copy(update={"port": 0}), lambda line: None, stop)

    def found(self):
        return {finding.subject: finding for finding in check_consistency(self.settings)}

    def kinds(self):
        return {subject: finding.kind for subject, finding in self.found().items()}
