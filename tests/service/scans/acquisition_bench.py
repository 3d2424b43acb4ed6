"""A data folder with its acquisition, whose scans run when a test says so."""

import threading
import time

from fabry_perot import RecoveryPolicy
from steradian.core.settings import Settings
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.runtime.acquisition import Acquisition
from steradian.runtime.scanner_address import ScannerConnection
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database
from steradian.storage.repositories.masks import MaskRepository
from steradian.storage.repositories.plans import PlanRepository
from steradian.storage.repositories.scanner_lease_and_stop import ScannerRepository
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import ScanState


class Port:
    """The link to a scanner that is there already."""

    def __init__(self, url):
        self._url = url

    def url(self):
        return self._url

    def present(self):
        return self._url

    def close(self):
        pass


class Bench:
    """One data directory with its acquisition; scans run when a test calls ``step``."""

    def __init__(self, folder, port=None, within=60.0):
        self.settings = Settings.create(data=folder, simulator_speed=50.0)
        self.data = DataDirectory(folder)
        self.data.create()
        self.database = Database(self.data.metadata_url)
        self.database.migrate()
        self.scans, self.plans = ScanRepository(self.database), PlanRepository(self.database)
        self.scanner = ScannerRepository(self.database)
        self.scanner.ensure(simulated=True)
        self.stopping = threading.Event()
        self.port = port or ScannerConnection(self.settings)
        recovery = RecoveryPolicy(within=within)  # generous: this machine may be busy
        self.work = Acquisition(self.scans, self.plans, self.data, self.port, self.stopping, recovery=recovery)

    def queue(self, count=60, **parameters):
        mask = equi_steradian_mask(aperture=13.56e-3, depth=3.6e-3, count=count)
        plan = ScanPlan.create(mask=mask, samples=256, **parameters)
        MaskRepository(self.database).put(mask)
        return self.scans.queue(self.plans.put(plan)[0], simulated=True).id

    def when_running(self, identifier, act):
        """Do something in a thread once the first A-lines of a scan are stored."""

        def watch():
            self.until(identifier, ScanState.RUNNING)
            act()

        self.meanwhile(watch)

    def until(self, identifier, *states):
        """Wait for one of some states."""
        deadline = time.monotonic() + 60
        while self.scans.get(identifier).state not in states:
            assert time.monotonic() < deadline, self.states(identifier)
            threading.Event().wait(0.01)

    def meanwhile(self, act):
        """Do something in a thread while a step is made."""

        thread = threading.Thread(target=act)
        thread.start()
        self.work.run_once()
        thread.join()

    def states(self, identifier):
        return [entry["state"] for entry in self.scans.get(identifier).history]

    def close(self):
        self.port.close()
        self.database.close()
