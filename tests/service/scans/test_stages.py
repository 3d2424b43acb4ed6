"""Scans in stages on a simulated scanner: the survey's A-lines are kept, and the next stage is made once."""

import shutil
import sys
import threading
from pathlib import Path

import h5py
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from staged_bench import PLACES, KnownPlanner, staged_plan

from fabry_perot.simulator import launch
from steradian.core.exceptions import Cancelled, InvalidInput, ScanInterrupted
from steradian.masks.staged import extend_mask
from steradian.plans.next_stage import plan_of_next_stage
from steradian.plans.preview import preview
from steradian.plans.stages import StoppingRule
from steradian.scans.acquisition.run import resume_scan, run_scan
from steradian.scans.acquisition.session_control import Command, SessionControl, SessionOutcome, SessionPhase
from steradian.scans.acquisition.stages import refuse_beyond_agreement
from steradian.scans.file.read import list_frames, read_scan
from steradian.scans.file.stages import read_stages


@pytest.fixture(scope="module")
def port():
    with launch(speed=200.0) as simulator:
        yield simulator.url


class Waiting(SessionControl):
    """A person who is asked, and answers or ends the scan."""

    can_ask = True

    def __init__(self, answer=None, end=None):
        super().__init__()
        self.answer, self.end, self.phases, self.fires = answer, end, [], []

    def on_phase(self, phase):
        self.phases.append(phase)

    def may_fire(self, allowed):
        self.fires.append(allowed)

    def command(self):
        waits = SessionPhase.DECIDING in self.phases
        return self.end if self.end is not None and waits else Command.RUN

    def decide(self, number, proposed):
        waits = SessionPhase.DECIDING in self.phases
        return (self.answer, "a person") if self.answer and waits else None


def test_survey_alines_are_kept_bit_for_bit_and_the_focus_is_measured(port, tmp_path):
    plan, path, copy = staged_plan(), tmp_path / "scan.h5", tmp_path / "survey.h5"
    planner = KnownPlanner(looked=lambda scan: shutil.copy(scan, copy))
    summary = run_scan(plan, port, path, scan_id="s1", planner=planner)
    survey, most = plan.mask.count, plan.most_points
    assert summary.end is SessionOutcome.COMPLETE
    assert survey < summary.points <= most
    assert summary.stored == summary.points == summary.fired, "each A-line is fired once"
    with h5py.File(copy) as before, h5py.File(path) as after:
        assert len(before["alines/status"]) == survey
        for name in before["alines"]:
            np.testing.assert_array_equal(after["alines"][name][:survey], before["alines"][name][:])
        np.testing.assert_array_equal(after["plan/visit"][:survey], before["plan/visit"][:])
        assert after.attrs["scan_id"] == "s1"
        shots = after["alines/shot"][:]
        assert shots[:survey].max() <= survey
    recording = read_scan(path)
    assert recording.weights.sum() == pytest.approx(
        recording.planned and h5py.File(path)["mask"].attrs["sensed_area_m2"]
    )
    assert not list(tmp_path.glob("*.stage*"))


def test_stage_records_tell_points_of_interest_plans_and_decision(port, tmp_path):
    plan, path = staged_plan(), tmp_path / "scan.h5"
    run_scan(plan, port, path, planner=KnownPlanner())
    first, second = read_stages(path)
    assert (first.number, first.points, first.plan_id) == (1, plan.mask.count, plan.id)
    assert second.points_of_interest == PLACES[:1]
    assert (second.number, second.decided_by) == (2, "auto")
    assert second.proposals[0].position == PLACES[0]
    with h5py.File(path) as file:
        assert file["plan"].attrs["id"] == second.plan_id
        assert len(file["mask/positions"]) == first.points + second.points


def test_resumed_scan_accepts_the_plan_of_any_of_its_stages(port, tmp_path):
    plan, path = staged_plan(), tmp_path / "scan.h5"
    run_scan(plan, port, path, planner=KnownPlanner())
    assert resume_scan(path, port, plan=plan).end is SessionOutcome.COMPLETE


def test_waiting_scan_holds_with_the_laser_off_until_a_person_chooses(port, tmp_path):
    control = Waiting(answer=PLACES[1:])
    summary = run_scan(staged_plan(decision="ask"), port, tmp_path / "scan.h5", planner=KnownPlanner(), control=control)
    assert summary.end is SessionOutcome.COMPLETE
    waiting = control.phases.index(SessionPhase.DECIDING)
    assert control.phases[waiting - 1 : waiting + 3] == [
        SessionPhase.PLANNING,
        SessionPhase.DECIDING,
        SessionPhase.ARMING,
        SessionPhase.RUNNING,
    ]
    assert control.fires == [True, False, True, False], "the laser is off between the stages"
    second = read_stages(tmp_path / "scan.h5")[1]
    assert (second.points_of_interest, second.decided_by) == (PLACES[1:], "a person")
    assert second.proposals[0].position == PLACES[0], "what was proposed is kept beside what was chosen"


@pytest.mark.parametrize(
    ("command", "outcome"), [(Command.STOP, SessionOutcome.STOPPED), (Command.ABORT, SessionOutcome.ABORTED)]
)
def test_command_ends_a_waiting_scan_and_a_resumed_one_goes_on(port, tmp_path, command, outcome):
    plan, path = staged_plan(decision="ask"), tmp_path / "scan.h5"
    summary = run_scan(plan, port, path, planner=KnownPlanner(), control=Waiting(end=command))
    assert (summary.end, summary.stored) == (outcome, plan.mask.count)
    assert read_stages(path) == ()
    resumed = resume_scan(path, port, plan=plan, planner=KnownPlanner(), chosen=PLACES[:1])
    assert resumed.end is SessionOutcome.COMPLETE
    assert resumed.stored == resumed.points > plan.mask.count
    assert [(stage.number, stage.decided_by) for stage in read_stages(path)] == [(1, ""), (2, "caller")]


@pytest.mark.parametrize(("decision", "found"), [("ask", PLACES[:1]), ("auto", ())])
def test_scan_that_nobody_can_decide_is_interrupted_with_its_survey_kept(port, tmp_path, decision, found):
    plan, path = staged_plan(decision=decision), tmp_path / "scan.h5"
    with pytest.raises(ScanInterrupted, match="stage 2 needs a point of interest"):
        run_scan(plan, port, path, planner=KnownPlanner(found))
    assert list_frames(path)[0].stored == plan.mask.count


def test_survey_is_measured_in_the_first_frame_only(port, tmp_path):
    plan, path = staged_plan(frames=2), tmp_path / "scan.h5"
    stored = []

    def look(scan):
        stored.extend(frame.stored for frame in list_frames(scan))

    summary = run_scan(plan, port, path, planner=KnownPlanner(looked=look))
    assert stored == [plan.mask.count, 0]
    assert summary.stored == summary.points == summary.fired == 2 * sum(stage.points for stage in read_stages(path))


def test_bias_wavelengths_of_the_focus_are_interpolated_between_the_survey_points():
    plan = staged_plan(survey=40)
    slope = 1550e-9 + 1e-6 * plan.mask.positions @ [0.3, -0.2]  # a plane, which interpolation keeps
    plan = plan.replace(wavelengths=slope)
    following = plan_of_next_stage(plan, extend_mask(plan.mask, PLACES[:1], plan.stages[0].points))
    np.testing.assert_array_equal(following.wavelengths[: plan.mask.count], slope)
    expected = 1550e-9 + 1e-6 * following.mask.positions @ [0.3, -0.2]
    np.testing.assert_allclose(following.wavelengths, expected, rtol=0, atol=1e-14)


def test_next_stage_beyond_what_was_agreed_to_is_refused():
    plan = staged_plan()
    allowed = plan.stages[0].points
    beyond = extend_mask(plan.mask, PLACES[:1], allowed + 10)
    with pytest.raises(InvalidInput, match="points"):
        plan_of_next_stage(plan, beyond)
    following = plan_of_next_stage(plan, extend_mask(plan.mask, PLACES[:1], allowed))
    refuse_beyond_agreement(plan, following)
    for change in ({"averages": 2}, {"pulse_rate": 60.0}, {"frames": 2}):
        with pytest.raises(InvalidInput, match="as agreed to"):
            refuse_beyond_agreement(plan, following.replace(**change))


def test_preview_counts_all_stages_and_tells_a_range_of_times():
    whole = staged_plan()
    cost = preview(whole)
    assert cost.seconds["laser"] == pytest.approx(whole.most_points / whole.pulse_rate)
    assert cost.least_seconds == cost.total_seconds
    early = preview(staged_plan(order="progressive", stopping=StoppingRule(min_points=30, max_points=50)))
    assert early.seconds["laser"] == pytest.approx(50 / whole.pulse_rate)
    assert early.least_seconds == pytest.approx(early.total_seconds * 30 / 50)


def test_plan_without_stages_keeps_its_identifier():
    plan = staged_plan()
    plain = plan.replace(stages=(), stopping=None)
    content = plain.model_dump(mode="json")
    assert plain.id != plan.id
    assert {"stages", "stage_ends", "stopping"} <= set(content)
    assert type(plain).create(**{name: getattr(plain, name) for name in ("mask", "samples")}).id == plain.id


def test_refused_plan_names_the_field(tmp_path):
    with pytest.raises(InvalidInput, match="planner"):
        run_scan(staged_plan(), "unused", tmp_path / "scan.h5")
    assert threading.active_count() < 20
    assert not list(tmp_path.iterdir())


def test_choice_for_a_scan_without_further_stage_is_refused_before_anything_is_measured(port, tmp_path):
    plan = staged_plan().replace(stages=())
    with pytest.raises(InvalidInput, match="chosen"):
        run_scan(plan, port, tmp_path / "scan.h5", chosen=PLACES[:1])
    assert not list(tmp_path.iterdir())


def test_stored_decision_comes_before_the_places_of_the_plan(port, tmp_path):
    class Decided(SessionControl):
        def decision(self, number):
            return PLACES[1:], "somebody"

    plan = staged_plan()
    plan = plan.replace(stages=(plan.stages[0].replace(points_of_interest=PLACES[:1]),))
    run_scan(plan, port, tmp_path / "scan.h5", planner=KnownPlanner(), control=Decided())
    second = read_stages(tmp_path / "scan.h5")[1]
    assert (second.points_of_interest, second.decided_by) == (PLACES[1:], "somebody")


@pytest.mark.parametrize("command", [Command.STOP, Command.ABORT])
def test_command_is_heard_while_a_stage_is_computed(port, tmp_path, command):
    class Slow(KnownPlanner):
        cancelled = threading.Event()

        def propose(self, path, stage):
            self.cancelled.clear()
            if not self.cancelled.wait(60):
                raise AssertionError("never cancelled")
            raise Cancelled("as wished")

        def cancel(self):
            self.cancelled.set()

    class Ending(Waiting):
        def command(self):
            return command if SessionPhase.PLANNING in self.phases else Command.RUN

    summary = run_scan(staged_plan(), port, tmp_path / "scan.h5", planner=Slow(), control=Ending())
    assert (summary.end, summary.stored) == (
        SessionOutcome.STOPPED if command is Command.STOP else SessionOutcome.ABORTED,
        24,
    )
    assert read_stages(tmp_path / "scan.h5") == ()


@pytest.mark.parametrize("failure", [InvalidInput("scan", "15 A-lines", "16"), OSError("no such image")])
def test_failed_search_interrupts_the_scan_and_keeps_the_survey(port, tmp_path, failure):
    class Blind(KnownPlanner):
        def propose(self, path, stage):
            raise failure

    with pytest.raises(ScanInterrupted):
        run_scan(staged_plan(), port, tmp_path / "scan.h5", planner=Blind())
    resumed = resume_scan(tmp_path / "scan.h5", port, planner=Blind(), chosen=PLACES[:1])
    assert resumed.end is SessionOutcome.COMPLETE


def test_pause_wished_while_a_stage_is_stored_holds_the_laser(port, tmp_path):
    class Pausing(Waiting):
        looks = 0

        def on_stages(self, stages, plan):
            self.made = bool(stages)

        def command(self):
            if getattr(self, "made", False) and self.looks < 3:
                self.looks += 1
                assert self.fires == [True, False], "paused: nothing is armed"
                return Command.PAUSE
            return Command.RUN

        def decide(self, number, proposed):
            return proposed, "auto"

    control = Pausing()
    summary = run_scan(staged_plan(), port, tmp_path / "scan.h5", planner=KnownPlanner(), control=control)
    assert (summary.end, control.looks) == (SessionOutcome.COMPLETE, 3)


def test_stage_beyond_the_plan_gets_no_pulse(port, tmp_path):

    class Greedy(KnownPlanner):
        def next_plan(self, plan, points):
            return super().next_plan(plan, points).replace(averages=2)

    with pytest.raises(ScanInterrupted, match="averages"):
        run_scan(staged_plan(), port, tmp_path / "scan.h5", planner=Greedy())
    assert list_frames(tmp_path / "scan.h5")[0].stored == 24
