"""The acquisition process's work, with a real database and the real simulator behind its link."""

import errno
import sys
import threading
from pathlib import Path

import h5py
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from acquisition_bench import Bench, Port

from fabry_perot.simulator import launch
from steradian.core.exceptions import Conflict, DamagedFile
from steradian.runtime.acquisition import Acquisition, count_alines
from steradian.scans.acquisition.session_control import SessionOutcome
from steradian.storage.blobs.interface import FolderBlobStore
from steradian.storage.state_machines import DesiredScanState, ScanState
from support.waiting import until

S, W = ScanState, DesiredScanState


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    bench = Bench(tmp_path_factory.mktemp("acquisition"))
    yield bench
    bench.close()


def test_a_queued_scan_runs_to_its_end_and_every_shot_is_accounted_for(bench):
    identifier = bench.queue()
    bench.work.run_once()
    row = bench.scans.get(identifier)
    assert bench.states(identifier) == ["queued", "arming", "running", "completing", "complete"]
    assert row.summary == {"points": 53, "stored": 53, "fired": 53}
    assert (row.stage, row.done, row.total) == ("A-lines", 53, 53)
    assert count_alines(bench.data.scan_file(identifier)) == row.summary


def test_stopped_scan_ends_partial_without_error(bench):
    identifier = bench.queue(pulse_rate=1.0)
    bench.when_running(identifier, lambda: bench.scans.set_desired_state(identifier, W.STOPPED, "seen enough"))
    row = bench.scans.get(identifier)
    assert bench.states(identifier)[-3:] == ["running", "stopping", "partial"]
    assert 0 < row.summary["stored"] < row.summary["points"]
    assert row.error_code is None


def test_completing_scan_copies_earlier_alines_and_measures_missing_ones(bench):
    earlier = bench.queue(pulse_rate=1.0)
    bench.when_running(earlier, lambda: bench.scans.set_desired_state(earlier, W.STOPPED, "lunch"))
    kept = bench.data.scan_file(earlier).read_bytes()
    held = bench.scans.get(earlier).summary["stored"]
    assert 0 < held < 53
    with bench.database.write() as session:
        plan = bench.plans.get(bench.scans.get(earlier).plan_id)
        following = bench.scans.add(session, plan, simulated=True, completes=earlier).id
    bench.work.run_once()
    row = bench.scans.get(following)
    assert (row.state, row.completes, row.summary["stored"]) == (S.COMPLETE, earlier, 53)
    assert row.summary["fired"] - held >= 53 - held, "besides what a proof takes"
    assert bench.data.scan_file(earlier).read_bytes() == kept
    with h5py.File(bench.data.scan_file(earlier)) as old, h5py.File(bench.data.scan_file(following)) as new:
        rows = old["alines/status"][:] == 1
        for name in old["alines"]:
            np.testing.assert_array_equal(new["alines"][name][rows], old["alines"][name][rows])
        assert (new.attrs["scan_id"], new.attrs["completes"]) == (following, earlier)


@pytest.mark.long
def test_completing_scan_with_missing_earlier_file_fails(bench):
    earlier = bench.queue()
    bench.work.run_once()
    with bench.database.write() as session:
        plan = bench.plans.get(bench.scans.get(earlier).plan_id)
        following = bench.scans.add(session, plan, simulated=True, completes=earlier).id
    bench.data.scan_file(earlier).unlink()
    bench.work.run_once()
    row = bench.scans.get(following)
    assert (row.state, row.error_code) == (S.FAILED, "not-found")
    assert not bench.data.scan_file(following).exists()


def test_the_scanners_row_during_and_after_a_scan_shows_interlock_key_and_shutter(tmp_path):
    """A pause closes the shutter and keeps the scanner; between scans the port is listened to."""
    with launch(speed=50.0) as simulator:
        bench = Bench(tmp_path, Port(simulator.url))
        identifier = bench.queue(pulse_rate=1.0, averages=20)

        def told():
            row = bench.scanner.get("scanner-0")
            return row.state, row.interlock, row.key_switch, row.shutter

        def act():
            until(lambda: told() == ("scanning", "closed", "on", "open"))
            bench.scans.set_desired_state(identifier, W.PAUSED, None)
            until(lambda: told() == ("paused", "closed", "on", "closed"))
            simulator.send_command("interlock", closed=False)
            until(lambda: told() == ("paused", "open", "on", "closed"))
            bench.scans.set_desired_state(identifier, W.ABORTED, None)

        assert told() == ("idle", "unknown", "unknown", "unknown")
        with bench.work.watching():
            bench.meanwhile(act)
            until(lambda: told() == ("idle", "open", "on", "closed"))
        bench.close()


def test_an_aborted_scan_ends_aborted_and_the_next_one_runs(bench):
    identifier = bench.queue(pulse_rate=1.0)
    bench.when_running(identifier, lambda: bench.scans.set_desired_state(identifier, W.ABORTED, "smoke"))
    assert bench.states(identifier)[-2:] == ["aborting", "aborted"]
    following = bench.queue()
    bench.work.run_once()
    assert bench.scans.get(following).state is S.COMPLETE


def test_queued_scan_that_was_stopped_never_fires(bench):
    identifier = bench.queue()
    bench.scans.set_desired_state(identifier, W.STOPPED, None)
    bench.work.run_once()
    assert bench.states(identifier) == ["queued", "aborted"]
    assert not bench.data.scan_file(identifier).exists()


def test_scan_with_plan_the_scanner_cannot_execute_fails_with_reason(bench):
    identifier = bench.queue(sampling_interval=1e-10)
    bench.work.run_once()
    row = bench.scans.get(identifier)
    assert (row.state, row.error_code) == (S.FAILED, "invalid-input")
    assert "sampling_interval" in row.error


def test_a_scanner_that_is_not_there_interrupts_the_scan_which_may_be_settled_by_hand(tmp_path):
    class Unplugged:
        def url(self):
            return str(tmp_path / "no-such-port")

        present = url

        def close(self):
            pass

    bench = Bench(tmp_path, Unplugged())
    identifier = bench.queue()
    bench.work.run_once()
    row = bench.scans.get(identifier)
    assert (row.state, row.error_code) == (S.INTERRUPTED, "scan-failed")
    assert "no-such-port" in row.error
    bench.work.run_once()
    assert bench.scans.get(identifier).state is S.INTERRUPTED, "the laser never starts by itself"
    bench.scans.set_desired_state(identifier, W.STOPPED, "lost")
    bench.work.run_once()
    assert bench.scans.get(identifier).state is S.PARTIAL
    bench.close()


@pytest.mark.long
def test_scan_not_fetchable_from_store_blocks_no_other_and_ends_partial(tmp_path):
    """Its own file is lost with an earlier node, and the store's copy cannot be fetched, then is damaged."""

    class Failing(FolderBlobStore):
        failure = OSError(errno.ENOSPC, "No space left on device")

        def open(self, name):
            raise self.failure

    bench = Bench(tmp_path)
    arrays = Failing(bench.data)
    work = Acquisition(bench.scans, bench.plans, bench.data, bench.port, bench.stopping, arrays=arrays)
    lost = bench.queue()
    for state in (S.ARMING, S.RUNNING, S.INTERRUPTED):
        bench.scans.transition(lost, state, why="test")
    bench.scans.set_desired_state(lost, W.STOPPED, "keep it")
    following = bench.queue()
    work.run_once()
    assert bench.scans.get(lost).state is S.INTERRUPTED
    assert bench.scans.get(following).state is S.COMPLETE
    arrays.failure = DamagedFile("its bytes are others")
    work.run_once()
    row = bench.scans.get(lost)
    assert (row.state, row.summary) == (S.PARTIAL, {})
    bench.close()


def test_when_the_service_ends_the_scan_is_made_safe_and_left_interrupted(tmp_path):
    bench = Bench(tmp_path)
    identifier = bench.queue(pulse_rate=1.0)
    bench.when_running(identifier, bench.stopping.set)
    assert bench.states(identifier)[-1] == "interrupted"
    assert bench.scans.get(identifier).summary["stored"] > 0
    bench.close()


@pytest.mark.long
def test_paused_scan_fires_nothing_until_resumed(bench):
    identifier = bench.queue(count=200, pulse_rate=1.0)
    fired = []

    def act():
        bench.until(identifier, S.RUNNING)
        bench.scans.set_desired_state(identifier, W.PAUSED, "coffee", "ann")
        bench.until(identifier, S.PAUSED)
        fired.append(count_alines(bench.data.scan_file(identifier))["stored"])
        threading.Event().wait(0.5)
        fired.append(count_alines(bench.data.scan_file(identifier))["stored"])
        bench.scans.set_desired_state(identifier, W.RUNNING, "back", "ann")

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
        bench.scans.set_desired_state(identifier, W.PAUSED, None)
        bench.until(identifier, S.PAUSED)
        bench.scans.set_desired_state(identifier, wish, None)

    bench.meanwhile(act)
    assert bench.states(identifier)[-3:] == ["paused", *end]


def test_abort_request_cannot_be_changed_to_stop(bench):
    identifier = bench.queue()
    bench.scans.set_desired_state(identifier, W.ABORTED, "smoke")
    with pytest.raises(Conflict, match="cannot be"):
        bench.scans.set_desired_state(identifier, W.STOPPED, "never mind")
    bench.work.run_once()
    assert bench.scans.get(identifier).state is S.ABORTED


def interrupted(bench):
    """A scan that the end of the service interrupted, in the hands of a service started anew."""
    identifier = bench.queue(pulse_rate=1.0)
    bench.when_running(identifier, bench.stopping.set)
    bench.stopping.clear()
    assert bench.scans.get(identifier).state is S.INTERRUPTED
    return identifier


def test_interrupted_scan_resumes_only_on_request(bench):
    identifier = interrupted(bench)
    stored = bench.scans.get(identifier).summary["stored"]
    bench.work.run_once()
    assert bench.scans.get(identifier).state is S.INTERRUPTED, "the laser never starts by itself"
    assert bench.scans.get(identifier).desired_state is W.PAUSED
    bench.scans.set_desired_state(identifier, W.RUNNING, "again", "ann")
    bench.work.run_once()
    row = bench.scans.get(identifier)
    states = [one for one in bench.states(identifier) if one != "recovering"]  # where the scanner still held some
    assert states[-5:] == ["interrupted", "arming", "running", "completing", "complete"]
    assert next(one["who"] for one in reversed(row.history) if one["state"] == "arming") == "ann"
    assert 0 < stored < row.summary["stored"] == 53


def test_resume_request_before_restart_is_cancelled_by_restart(bench):
    identifier = interrupted(bench)
    bench.scans.set_desired_state(identifier, W.RUNNING, None)
    bench.work._begin()  # the acquisition process starts anew
    bench.work.run_once()
    row = bench.scans.get(identifier)
    assert (row.state, row.desired_state, row.reason) == (S.INTERRUPTED, W.PAUSED, "the service was restarted")
    bench.scans.set_desired_state(identifier, W.STOPPED, None)
    bench.work.run_once()
    assert bench.scans.get(identifier).state is S.PARTIAL


@pytest.mark.long
def test_resume_after_bias_drift_is_refused_until_drift_is_gone(tmp_path):
    """The difference is named, the scan stays interrupted, and it goes on when things are as before."""

    with launch(speed=50.0) as simulator:
        bench = Bench(tmp_path, Port(simulator.url))
        identifier = interrupted(bench)
        simulator.send_command("drift", pm=400)
        bench.scans.set_desired_state(identifier, W.RUNNING, None)
        bench.work.run_once()
        row = bench.scans.get(identifier)
        assert (row.state, row.desired_state, row.error_code) == (S.INTERRUPTED, W.PAUSED, "resume-refused")
        assert "bias wavelength" in row.error
        simulator.send_command("drift", pm=0)
        bench.scans.set_desired_state(identifier, W.RUNNING, None)
        bench.work.run_once()
        assert bench.scans.get(identifier).state is S.COMPLETE
        assert bench.scans.get(identifier).error_code is None
        bench.close()


@pytest.mark.long
def test_a_resume_is_refused_where_the_a_lines_that_were_stored_are_not(tmp_path):
    """On a node with a new folder: begun anew it would fire at all points again and replace what is kept elsewhere."""
    bench = Bench(tmp_path)
    identifier = interrupted(bench)
    away = bench.data.scan_file(identifier).rename(tmp_path / "away.h5")
    bench.scans.set_desired_state(identifier, W.RUNNING, None)
    bench.work.run_once()
    row = bench.scans.get(identifier)
    assert (row.state, row.error_code) == (S.INTERRUPTED, "resume-refused")
    assert "not in this node's folder" in row.error
    away.rename(bench.data.scan_file(identifier))
    bench.scans.set_desired_state(identifier, W.RUNNING, None)
    bench.work.run_once()
    assert bench.scans.get(identifier).state is S.COMPLETE
    bench.close()


@pytest.mark.parametrize(("end", "state"), [(SessionOutcome.ABORTED, "aborted"), (SessionOutcome.STOPPED, "partial")])
def test_scan_with_uncountable_alines_does_not_end_complete(bench, monkeypatch, end, state):
    scan = bench.queue()
    for following in (ScanState.ARMING, ScanState.RUNNING):
        bench.scans.transition(scan, following, why="test")
    bench.data.scan_file(scan).write_bytes(b"no scan")
    bench.work._finish(scan, end)
    assert bench.scans.get(scan).state == state
