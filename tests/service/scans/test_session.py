"""The life of a scan on the real simulator behind its link: pause, stop, resume, retry, frames, and nothing twice."""

import shutil
import sys
import threading
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from scripted import QUIET, Script, samples

from fabry_perot import RecoveryPolicy
from fabry_perot.simulator import launch
from steradian.core.exceptions import Conflict, DiskFull, InvalidInput, ScanFailed
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.scans.acquisition.resume_checks import ResumeRefused
from steradian.scans.acquisition.run import RETRY_FLAGS, resume_scan, run_scan
from steradian.scans.acquisition.session_control import Command, SessionControl, SessionOutcome, SessionPhase
from steradian.scans.file.read import list_frames, read_scan
from steradian.scans.file.verify import verify_scan_file


@pytest.fixture(scope="module")
def plan():
    mask = equi_steradian_mask(aperture=13.56e-3, depth=3.6e-3, count=60)
    return ScanPlan.create(mask=mask, samples=512, pulse_rate=100.0)


@pytest.fixture(scope="module")
def simulator():
    with launch(speed=20.0, **QUIET) as simulator:
        yield simulator


@pytest.fixture(scope="module")
def whole(simulator, plan, tmp_path_factory):
    """The samples of a scan that nothing disturbed."""
    path = tmp_path_factory.mktemp("whole") / "scan.h5"
    run_scan(plan, simulator.url, path)
    return samples(path)


def stop_at(plan, simulator, path, count):
    return run_scan(plan, simulator.url, path, control=Script((count, Command.STOP)))


def test_a_stopped_scan_keeps_every_shot_that_was_fired(plan, simulator, tmp_path):
    summary = stop_at(plan, simulator, tmp_path / "a.h5", 20)
    assert summary.end is SessionOutcome.STOPPED
    assert 20 <= summary.stored == summary.fired < summary.points


def test_a_resumed_scan_is_bit_for_bit_the_one_that_nothing_disturbed(plan, simulator, whole, tmp_path):
    path = tmp_path / "a.h5"
    before = stop_at(plan, simulator, path, 20)
    control = Script()
    after = resume_scan(path, simulator.url, plan=plan, control=control)
    assert (after.end, after.stored) == (SessionOutcome.COMPLETE, plan.mask.count)
    assert after.fired == before.fired + (plan.mask.count - before.stored) + 16, "the missing points and the reference"
    assert control.phases == [SessionPhase.ARMING, SessionPhase.RUNNING, SessionPhase.COMPLETING]
    np.testing.assert_array_equal(samples(path), whole)
    assert all(finding.agrees for finding in after.findings)
    assert {"the scanner", "the plan", "the tuning map"} <= {finding.what for finding in after.findings}


def test_a_complete_scan_is_resumed_without_a_shot(plan, simulator, tmp_path):
    path = tmp_path / "a.h5"
    fired = run_scan(plan, simulator.url, path).fired
    assert resume_scan(path, simulator.url).fired == fired


@pytest.mark.parametrize(
    ("wish", "end"), [(Command.STOP, SessionOutcome.STOPPED), (Command.ABORT, SessionOutcome.ABORTED)]
)
def test_resume_of_stopped_or_aborted_scan_fires_nothing(plan, simulator, tmp_path, wish, end):
    """The reference point, too, is measured only for somebody who wants the scan."""
    path = tmp_path / "a.h5"
    stop_at(plan, simulator, path, 20)
    fired = simulator.send_command("report")["shots"]
    summary = resume_scan(path, simulator.url, control=Script((0, wish)))
    assert (summary.end, simulator.send_command("report")["shots"]) == (end, fired)


def test_another_plan_is_refused_and_named(plan, simulator, tmp_path):
    path = tmp_path / "a.h5"
    fired = stop_at(plan, simulator, path, 20).fired
    other = plan.replace(pulse_rate=50.0)
    with pytest.raises(ResumeRefused, match=f"the plan was {plan.id} and is {other.id}"):
        resume_scan(path, simulator.url, plan=other)
    assert resume_scan(path, simulator.url).fired - fired == plan.mask.count - fired + 16


@pytest.mark.long
def test_another_scanner_and_another_object_are_refused_and_named(plan, simulator, tmp_path):
    path = tmp_path / "a.h5"
    stop_at(plan, simulator, path, 20)
    before = samples(path)
    with launch(speed=20.0, seed=7) as other, pytest.raises(ResumeRefused, match="SIM-0000 and is SIM-0007"):
        resume_scan(path, other.url)
    with launch(speed=20.0, phantom="star", **QUIET) as other, pytest.raises(ResumeRefused, match="correlated"):
        resume_scan(path, other.url)
    np.testing.assert_array_equal(samples(path), before)


def test_resume_after_kill_reads_buffered_alines_without_refiring(plan, simulator, whole, tmp_path):
    """The A-lines lie in the scanner's ring: fired, never acknowledged."""

    class Killed(BaseException):
        pass

    class Dies(Script):
        def progress(self, done, total):
            if done >= 20:
                raise Killed

    path = tmp_path / "a.h5"
    before = simulator.send_command("report")["shots"]
    with pytest.raises(Killed):
        run_scan(plan, simulator.url, path, control=Dies())
    time.sleep(0.1)

    phases = []

    class Notes(SessionControl):
        def on_phase(self, phase):
            phases.append(phase)

    summary = resume_scan(path, simulator.url, control=Notes())
    assert phases[0] == ("rescuing" if summary.rescued else "arming"), "it is told that the file is written to"
    assert summary.stored == plan.mask.count
    assert simulator.send_command("report")["shots"] - before == summary.fired == plan.mask.count + 16
    np.testing.assert_array_equal(samples(path), whole)


def test_flagged_alines_are_measured_again_into_the_same_file(plan, simulator, whole, tmp_path):
    path = tmp_path / "a.h5"
    summary = run_scan(plan, simulator.url, path)
    bad = [3, 40]
    with h5py.File(path, "r+") as file:
        for row in bad:
            file["alines/quality"][row] = 1
            file["alines/samples"][row] = 0
            file["alines/crc32c"][row] = 0x5A5A5A5A
    report = verify_scan_file(path)
    assert report.damaged.tolist() == bad, "measured again because they are damaged"
    with h5py.File(path, "r+") as file:
        file["alines/quality"][7] = 1
    after = resume_scan(path, simulator.url, retry=RETRY_FLAGS)
    assert after.fired == summary.fired + 16 + 3
    np.testing.assert_array_equal(samples(path), whole)
    with h5py.File(path) as file:
        assert not file["alines/quality"][:].any()


def test_frames_and_excitation_wavelengths_each_have_their_alines(plan, simulator, whole, tmp_path):
    """Two frames at each of two wavelengths; the simulated object absorbs with the wavelength's power -2."""
    path = tmp_path / "a.h5"
    wanted = plan.replace(frames=2, excitation=(800e-9, 1000e-9))
    summary = run_scan(wanted, simulator.url, path, control=Script((150, Command.STOP)))
    summary = resume_scan(path, simulator.url, plan=wanted)
    assert summary.stored == summary.points == 4 * plan.mask.count
    assert [(frame.excitation, frame.stored) for frame in list_frames(path)] == [
        (wavelength, plan.mask.count) for wavelength in (800e-9, 800e-9, 1000e-9, 1000e-9)
    ]
    for frame in (0, 1):
        np.testing.assert_array_equal(read_scan(path, frame).traces, whole)
    for frame in (2, 3):
        np.testing.assert_allclose(read_scan(path, frame).traces, whole * 0.64, atol=1)
    assert read_scan(path, 3).provenance["excitation"] == "1000 nm"
    with pytest.raises(InvalidInput, match="0 to 3"):
        read_scan(path, 4)
    simulator.send_command("report")


def test_a_wavelength_the_scanner_cannot_do_is_bad_input(plan, simulator, tmp_path):
    with pytest.raises(InvalidInput, match="excitation"):
        run_scan(plan.replace(excitation=(300e-9,)), simulator.url, tmp_path / "a.h5")
    assert not (tmp_path / "a.h5").exists()


def test_averages_are_averaged_by_the_scanner_and_counted(plan, simulator, tmp_path):
    summary = run_scan(plan.replace(averages=4), simulator.url, tmp_path / "a.h5")
    assert summary.fired == 4 * summary.stored == 4 * plan.mask.count


@pytest.mark.long
def test_lost_link_that_returns_is_reported_and_loses_no_data(plan, whole, tmp_path):
    class Unplugs(Script):
        def progress(self, done, total):
            super().progress(done, total)
            if done >= 20 and not self.phases.count("unplugged"):
                self.phases.append("unplugged")
                simulator.send_command("unplug", seconds=4.0)

    with launch(speed=4.0, **QUIET) as simulator:
        control = Unplugs()
        within = RecoveryPolicy(
            within=60.0
        )  # when the laser may come back is not asked here, and a busy machine is late
        summary = run_scan(plan, simulator.url, tmp_path / "a.h5", control=control, recovery=within)
    assert summary.stored == summary.fired == plan.mask.count
    after = control.phases[control.phases.index("unplugged") + 1 :]
    assert after == [SessionPhase.RECOVERING, SessionPhase.RUNNING, SessionPhase.COMPLETING]
    np.testing.assert_array_equal(samples(tmp_path / "a.h5"), whole)


def test_abort_during_process_stall_takes_effect_before_laser_rearms(plan, tmp_path):
    """The lease lapses meanwhile; it is not renewed for a scan that nobody wants any more."""

    class HeldUp(Script):
        def progress(self, done, total):
            super().progress(done, total)
            if done >= 20 and not self.wishes:
                threading.Event().wait(1.0)
                shots.append(simulator.send_command("report")["shots"])
                self.wishes = [(0, Command.ABORT)]

    shots = []
    with launch(speed=20.0, **QUIET) as simulator:
        control = HeldUp()
        assert run_scan(plan, simulator.url, tmp_path / "a.h5", control=control).end is SessionOutcome.ABORTED
        assert simulator.send_command("report")["shots"] == shots[0]
    assert control.phases[-1] is SessionPhase.ABORTING


def test_scan_aborted_before_start_fires_nothing(plan, simulator, tmp_path):
    before = simulator.send_command("report")["shots"]
    summary = run_scan(plan, simulator.url, tmp_path / "a.h5", control=Script((0, Command.ABORT)))
    assert (summary.end, summary.stored, summary.fired) == (SessionOutcome.ABORTED, 0, 0)
    assert simulator.send_command("report")["shots"] == before


@pytest.mark.long
def test_a_scanner_that_vanishes_leaves_a_scan_that_another_session_ends(plan, whole, tmp_path):
    class Goes(Script):
        def progress(self, done, total):
            if done >= 20:
                raise ScanFailed("unplugged")

    path = tmp_path / "a.h5"
    with launch(speed=20.0, **QUIET) as gone, pytest.raises(ScanFailed):
        run_scan(plan, gone.url, path, control=Goes())
    with launch(speed=20.0, **QUIET) as simulator:
        assert resume_scan(path, simulator.url).stored == plan.mask.count
    np.testing.assert_array_equal(samples(path), whole)


def test_a_scan_that_does_not_fit_is_refused_below_the_need_and_only_there(plan, simulator, tmp_path, monkeypatch):
    from steradian.scans.file import create as layout

    need = layout.scan_file_bytes(plan)
    free = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(layout.shutil, "disk_usage", lambda folder: free._replace(free=need - 1))
    with pytest.raises(DiskFull, match="MB free"):
        run_scan(plan, simulator.url, tmp_path / "a.h5")
    assert not (tmp_path / "a.h5").exists()
    monkeypatch.setattr(layout.shutil, "disk_usage", lambda folder: free._replace(free=need + 1))
    assert "of the" in layout.check_free_space(tmp_path, need)
    assert run_scan(plan, simulator.url, tmp_path / "a.h5").stored == plan.mask.count


def test_the_size_of_a_scan_file_is_known_before_it_is_made(plan, simulator, tmp_path):
    from steradian.scans.file import create as layout

    run_scan(plan, simulator.url, tmp_path / "a.h5")
    size, said = (tmp_path / "a.h5").stat().st_size, layout.scan_file_bytes(plan)
    assert size <= said < size + 65_536


@pytest.mark.long
def test_an_existing_file_is_no_place_for_a_new_scan(plan, simulator, tmp_path):
    path = tmp_path / "a.h5"
    path.write_text("mine")
    with pytest.raises(Conflict, match="exists"):
        run_scan(plan, simulator.url, path)
    assert path.read_text() == "mine"
