"""The acquisition process's work, with a real database and the real simulator behind its link."""

import threading

import pytest

from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.scans.acquisition import Acquisition, ScannerPort, count_alines
from steradian.settings import Settings
from steradian.storage.database import Database
from steradian.storage.masks import MaskRepository
from steradian.storage.paths import DataDirectory
from steradian.storage.plans import PlanRepository
from steradian.storage.scanners import ScannerRepository
from steradian.storage.scans import ScanRepository
from steradian.storage.states import DesiredScanState, ScanState

S, W = ScanState, DesiredScanState


class Bench:
    """One data directory with its acquisition; scans run when a test calls ``step``."""

    def __init__(self, folder, port=None):
        self.settings = Settings.create(data=folder, simulator_speed=50.0)
        self.data = DataDirectory(folder)
        self.data.create()
        self.database = Database(self.data.metadata_url)
        self.database.migrate()
        self.scans, self.plans = ScanRepository(self.database), PlanRepository(self.database)
        self.scanner = ScannerRepository(self.database)
        self.scanner.ensure(simulated=True)
        self.stopping = threading.Event()
        self.port = port or ScannerPort(self.settings)
        self.work = Acquisition(self.scans, self.plans, self.data, self.port, self.stopping)

    def queue(self, **parameters):
        mask = equi_steradian_mask(aperture=13.56e-3, depth=3.6e-3, count=60)
        plan = ScanPlan.create(mask=mask, samples=256, **parameters)
        MaskRepository(self.database).put(mask)
        return self.scans.queue(self.plans.put(plan)[0], simulated=True).id

    def when_running(self, identifier, act):
        """Do something in a thread once the first A-lines of a scan are stored."""

        def watch():
            while self.scans.get(identifier).state is not S.RUNNING and not over.wait(0.01):
                pass
            act()

        over = threading.Event()
        thread = threading.Thread(target=watch)
        thread.start()
        self.work.step()
        over.set()
        thread.join()

    def states(self, identifier):
        return [entry["state"] for entry in self.scans.get(identifier).history]

    def close(self):
        self.port.close()
        self.database.close()


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    bench = Bench(tmp_path_factory.mktemp("acquisition"))
    yield bench
    bench.close()


def test_a_queued_scan_runs_to_its_end_and_every_shot_is_accounted_for(bench):
    identifier = bench.queue()
    bench.work.step()
    row = bench.scans.get(identifier)
    assert bench.states(identifier) == ["queued", "arming", "running", "completing", "complete"]
    assert row.summary == {"points": 69, "stored": 69, "fired": 69}
    assert (row.stage, row.done, row.total) == ("A-lines", 69, 69)
    assert count_alines(bench.data.scan_file(identifier)) == row.summary


def test_a_stopped_scan_is_a_success_that_keeps_what_was_measured(bench):
    identifier = bench.queue(pulse_rate=1.0)
    bench.when_running(identifier, lambda: bench.scans.desire(identifier, W.STOPPED, "seen enough"))
    row = bench.scans.get(identifier)
    assert bench.states(identifier)[-3:] == ["running", "stopping", "partial"]
    assert 0 < row.summary["stored"] < row.summary["points"]
    assert row.error_code is None


def test_an_aborted_scan_ends_aborted_and_the_next_one_runs(bench):
    identifier = bench.queue(pulse_rate=1.0)
    bench.when_running(identifier, lambda: bench.scans.desire(identifier, W.ABORTED, "smoke"))
    assert bench.states(identifier)[-2:] == ["aborting", "aborted"]
    following = bench.queue()
    bench.work.step()
    assert bench.scans.get(following).state is S.COMPLETE


def test_a_scan_that_is_not_wanted_any_more_never_fires(bench):
    identifier = bench.queue()
    bench.scans.desire(identifier, W.STOPPED, None)
    bench.work.step()
    assert bench.states(identifier) == ["queued", "aborted"]
    assert not bench.data.scan_file(identifier).exists()


def test_a_plan_the_scanner_cannot_do_fails_and_says_why(bench):
    identifier = bench.queue(sampling_interval=1e-10)
    bench.work.step()
    row = bench.scans.get(identifier)
    assert (row.state, row.error_code) == (S.FAILED, "invalid-input")
    assert "sampling_interval" in row.error


def test_a_scanner_that_is_not_there_interrupts_the_scan_which_may_be_settled_by_hand(tmp_path):
    class Unplugged:
        def url(self):
            return str(tmp_path / "no-such-port")

        def close(self):
            pass

    bench = Bench(tmp_path, Unplugged())
    identifier = bench.queue()
    bench.work.step()
    row = bench.scans.get(identifier)
    assert (row.state, row.error_code) == (S.INTERRUPTED, "scan-failed")
    assert "no-such-port" in row.error
    bench.work.step()
    assert bench.scans.get(identifier).state is S.INTERRUPTED, "the laser never starts by itself"
    bench.scans.desire(identifier, W.STOPPED, "lost")
    bench.work.step()
    assert bench.scans.get(identifier).state is S.PARTIAL
    bench.close()


def test_when_the_service_ends_the_scan_is_made_safe_and_left_interrupted(tmp_path):
    bench = Bench(tmp_path)
    identifier = bench.queue(pulse_rate=1.0)
    bench.when_running(identifier, bench.stopping.set)
    assert bench.states(identifier)[-1] == "interrupted"
    assert bench.scans.get(identifier).summary["stored"] > 0
    bench.close()
