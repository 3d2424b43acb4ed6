"""The acquisition process's work, with a real database and the real simulator behind its link."""

import errno
import shutil
import threading
import time

import pytest

from fabry_perot import Recovery
from fabry_perot.simulator import launch
from steradian.errors import Conflict
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.runtime.acquisition import Acquisition, ScannerPort, count_alines
from steradian.scans.layout import scan_file_bytes
from steradian.scans.store import AlineStore
from steradian.settings import Settings
from steradian.storage.database import Database
from steradian.storage.masks import MaskRepository
from steradian.storage.paths import DataDirectory
from steradian.storage.plans import PlanRepository
from steradian.storage.scanners import ScannerRepository
from steradian.storage.scans import ScanRepository
from steradian.storage.states import DesiredScanState, ScanState

S, W = ScanState, DesiredScanState


class Port:
    """The link to a scanner that is there already."""

    def __init__(self, url):
        self._url = url

    def url(self):
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
        self.port = port or ScannerPort(self.settings)
        recovery = Recovery(within=within)  # generous: this machine may be busy
        self.work = Acquisition(self.scans, self.plans, self.data, self.port, self.stopping, recovery=recovery)

    def queue(self, count=60, **parameters):
        mask = equi_steradian_mask(aperture=13.56e-3, depth=3.6e-3, count=count)
        plan = ScanPlan.create(mask=mask, samples=256, **parameters)
        MaskRepository(self.database).put(mask)
        return self.scans.queue(self.plans.put(plan)[0], simulated=True).id

    def when_running(self, identifier, act):
        """Do something in a thread once the first A-lines of a scan are stored."""

        def watch():
            self.until(identifier, S.RUNNING)
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
        self.work.step()
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
    assert row.summary == {"points": 53, "stored": 53, "fired": 53}
    assert (row.stage, row.done, row.total) == ("A-lines", 53, 53)
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


def test_a_paused_scan_fires_nothing_and_goes_on_when_wished(bench):
    identifier = bench.queue(count=200, pulse_rate=1.0)
    fired = []

    def act():
        bench.until(identifier, S.RUNNING)
        bench.scans.desire(identifier, W.PAUSED, "coffee", "ann")
        bench.until(identifier, S.PAUSED)
        fired.append(count_alines(bench.data.scan_file(identifier))["stored"])
        threading.Event().wait(0.5)
        fired.append(count_alines(bench.data.scan_file(identifier))["stored"])
        bench.scans.desire(identifier, W.RUNNING, "back", "ann")

    bench.meanwhile(act)
    row = bench.scans.get(identifier)
    ended = ["running", "completing", "complete"]
    assert bench.states(identifier)[2:] == ["running", "pausing", "paused", "arming", *ended]
    assert row.summary == {"points": 213, "stored": 213, "fired": 213}
    assert fired[0] == fired[1] < 213
    told = {entry["state"]: (entry["who"], entry["why"]) for entry in row.history[:6]}
    assert told["pausing"] == ("ann", "coffee")
    assert told["arming"] == ("ann", "back")


@pytest.mark.parametrize(("wish", "end"), [(W.STOPPED, ["stopping", "partial"]), (W.ABORTED, ["aborting", "aborted"])])
def test_a_paused_scan_can_be_ended(bench, wish, end):
    identifier = bench.queue(pulse_rate=1.0)

    def act():
        bench.until(identifier, S.RUNNING)
        bench.scans.desire(identifier, W.PAUSED, None)
        bench.until(identifier, S.PAUSED)
        bench.scans.desire(identifier, wish, None)

    bench.meanwhile(act)
    assert bench.states(identifier)[-3:] == ["paused", *end]


def test_a_wish_to_abort_cannot_be_taken_back(bench):
    identifier = bench.queue()
    bench.scans.desire(identifier, W.ABORTED, "smoke")
    with pytest.raises(Conflict, match="cannot be"):
        bench.scans.desire(identifier, W.STOPPED, "never mind")
    bench.work.step()
    assert bench.scans.get(identifier).state is S.ABORTED


def interrupted(bench):
    """A scan that the end of the service interrupted, in the hands of a service started anew."""
    identifier = bench.queue(pulse_rate=1.0)
    bench.when_running(identifier, bench.stopping.set)
    bench.stopping.clear()
    assert bench.scans.get(identifier).state is S.INTERRUPTED
    return identifier


def test_an_interrupted_scan_goes_on_when_wished_and_only_then(bench):
    identifier = interrupted(bench)
    stored = bench.scans.get(identifier).summary["stored"]
    bench.work.step()
    assert bench.scans.get(identifier).state is S.INTERRUPTED, "the laser never starts by itself"
    assert bench.scans.get(identifier).desired_state is W.PAUSED
    bench.scans.desire(identifier, W.RUNNING, "again", "ann")
    bench.work.step()
    row = bench.scans.get(identifier)
    assert bench.states(identifier)[-5:] == ["interrupted", "arming", "running", "completing", "complete"]
    assert row.history[-4]["who"] == "ann"
    assert 0 < stored < row.summary["stored"] == 53


def test_a_wish_that_nobody_was_there_to_hear_fires_nothing_later(bench):
    identifier = interrupted(bench)
    bench.scans.desire(identifier, W.RUNNING, None)
    bench.work._begin()  # the acquisition process starts anew
    bench.work.step()
    row = bench.scans.get(identifier)
    assert (row.state, row.desired_state, row.reason) == (S.INTERRUPTED, W.PAUSED, "the service was restarted")
    bench.scans.desire(identifier, W.STOPPED, None)
    bench.work.step()
    assert bench.scans.get(identifier).state is S.PARTIAL


def test_a_resume_is_refused_while_the_film_is_not_what_it_was(tmp_path):
    """The difference is named, the scan stays interrupted, and it goes on when things are as before."""

    with launch(speed=50.0) as simulator:
        bench = Bench(tmp_path, Port(simulator.url))
        identifier = interrupted(bench)
        simulator.command("drift", pm=400)
        bench.scans.desire(identifier, W.RUNNING, None)
        bench.work.step()
        row = bench.scans.get(identifier)
        assert (row.state, row.desired_state, row.error_code) == (S.INTERRUPTED, W.PAUSED, "resume-refused")
        assert "bias wavelength" in row.error
        simulator.command("drift", pm=0)
        bench.scans.desire(identifier, W.RUNNING, None)
        bench.work.step()
        assert bench.scans.get(identifier).state is S.COMPLETE
        assert bench.scans.get(identifier).error_code is None
        bench.close()


def test_while_the_disk_is_full_the_laser_rests_and_the_scan_says_so(bench, monkeypatch):
    identifier = bench.queue(pulse_rate=5.0)
    full, overwrite = threading.Event(), AlineStore._overwrite

    def write(store, offset, data):
        if full.is_set():
            raise OSError(errno.ENOSPC, "No space left on device")
        overwrite(store, offset, data)

    monkeypatch.setattr(AlineStore, "_overwrite", write)
    monkeypatch.setattr("steradian.scans.session.AGAIN", 0.05)
    stages, stored = [], []

    def act():
        bench.until(identifier, S.RUNNING)
        full.set()
        while not (bench.scans.get(identifier).stage or "").startswith("blocked"):
            threading.Event().wait(0.01)
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


def test_a_laser_that_rested_for_a_full_disk_for_too_long_comes_back_only_when_wished(tmp_path, monkeypatch):
    """Everything that was fired before is stored once there is room."""
    bench = Bench(tmp_path, within=0.0)
    full, overwrite = threading.Event(), AlineStore._overwrite

    def write(store, offset, data):
        if full.is_set():
            raise OSError(errno.ENOSPC, "No space left on device")
        overwrite(store, offset, data)

    monkeypatch.setattr(AlineStore, "_overwrite", write)
    monkeypatch.setattr("steradian.scans.session.AGAIN", 0.05)
    identifier = bench.queue(pulse_rate=5.0)

    def act():
        bench.until(identifier, S.RUNNING)
        full.set()
        while not (bench.scans.get(identifier).stage or "").startswith("blocked"):
            threading.Event().wait(0.01)
        full.clear()

    bench.meanwhile(act)
    row = bench.scans.get(identifier)
    assert (row.state, row.desired_state, row.error_code) == (S.INTERRUPTED, W.PAUSED, "scan-interrupted")
    assert row.summary["fired"] == row.summary["stored"] < 53
    bench.work._recovery = Recovery(within=60.0)
    bench.scans.desire(identifier, W.RUNNING, None)
    bench.work.step()
    assert bench.scans.get(identifier).state is S.COMPLETE
    bench.close()


def test_an_interlock_opened_while_the_laser_rested_for_a_full_disk_keeps_it_off_until_wished(tmp_path, monkeypatch):
    """Somebody has opened the enclosure meanwhile, so a person decides, however soon there is room again."""
    full, overwrite = threading.Event(), AlineStore._overwrite

    def write(store, offset, data):
        if full.is_set():
            raise OSError(errno.ENOSPC, "No space left on device")
        overwrite(store, offset, data)

    monkeypatch.setattr(AlineStore, "_overwrite", write)
    monkeypatch.setattr("steradian.scans.session.AGAIN", 0.05)
    with launch(speed=50.0) as simulator:
        bench = Bench(tmp_path, Port(simulator.url))
        identifier = bench.queue(pulse_rate=5.0)

        def act():
            bench.until(identifier, S.RUNNING)
            full.set()
            while not (bench.scans.get(identifier).stage or "").startswith("blocked"):
                threading.Event().wait(0.01)
            simulator.command("interlock", closed=False)
            threading.Event().wait(0.1)  # time enough for the device to see it, at whatever speed
            simulator.command("interlock", closed=True)
            full.clear()

        bench.meanwhile(act)
        row = bench.scans.get(identifier)
        assert (row.state, row.desired_state, row.error_code) == (S.INTERRUPTED, W.PAUSED, "scan-interrupted")
        assert row.summary["fired"] == row.summary["stored"] < 53
        bench.scans.desire(identifier, W.RUNNING, None)
        bench.work.step()
        assert bench.scans.get(identifier).state is S.COMPLETE
        bench.close()


def test_a_scan_that_cannot_fit_fails_before_a_pulse(bench, monkeypatch):
    usage = shutil.disk_usage(bench.data.root)._replace(free=1000)
    monkeypatch.setattr("steradian.scans.layout.shutil.disk_usage", lambda folder: usage)
    identifier = bench.queue()
    bench.work.step()
    row = bench.scans.get(identifier)
    assert (row.state, row.error_code) == (S.FAILED, "disk-full")
    assert "0.0 MB free" in row.error
    assert not bench.data.scan_file(identifier).exists()


def test_a_disk_that_will_be_nearly_full_is_a_warning_and_no_obstacle(bench, monkeypatch):
    identifier = bench.queue()
    plan = bench.plans.load(bench.scans.get(identifier).plan_id)
    usage = shutil.disk_usage(bench.data.root)._replace(free=scan_file_bytes(plan) + 1)
    monkeypatch.setattr("steradian.scans.layout.shutil.disk_usage", lambda folder: usage)
    bench.work.step()
    row = bench.scans.get(identifier)
    assert row.state is S.COMPLETE
    assert "MB free" in row.history[1]["why"]
