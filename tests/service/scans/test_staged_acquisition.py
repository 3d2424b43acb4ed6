"""Scans in stages by the acquisition process, with a real database and a simulated scanner."""

import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from acquisition_bench import Bench
from staged_bench import APERTURE, PLACES, KnownPlanner, staged_plan

from fabry_perot.simulator.named_phantoms import by_name
from steradian.core.exceptions import Conflict, NotFound
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.plans.next_stage import plan_in_stages
from steradian.plans.stages import FocusStage
from steradian.runtime import acquisition
from steradian.scans.acquisition.database_control import DatabaseControl
from steradian.scans.file.stages import read_stages
from steradian.storage.repositories.masks import MaskRepository
from steradian.storage.repositories.references import Resource, lock_dependents
from steradian.storage.repositories.scan_stages import ScanStageRepository, has_further_stages
from steradian.storage.state_machines import DesiredScanState, ScanState
from support.waiting import until

S, W = ScanState, DesiredScanState


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    bench = Bench(tmp_path_factory.mktemp("stages"))
    yield bench
    bench.close()


@pytest.fixture(autouse=True)
def planner(request, monkeypatch):
    """Computation in this process where no test is of the other one, which takes a second to start."""
    if "yarn" not in request.node.name:
        monkeypatch.setattr(acquisition, "ChildStagePlanner", lambda: KnownPlanner(()))


def queue(bench, **stage):
    """Queue a scan of a survey of 24 points whose focus nothing is found for: a person chooses, or the plan does."""
    plan = staged_plan(decision="ask")
    rule = plan.stages[0].model_dump() | {"least_signal_to_noise": 1000.0} | stage
    plan = plan.replace(stages=(FocusStage.create(**rule),))
    MaskRepository(bench.database).put(plan.mask)
    return bench.scans.queue(bench.plans.put(plan)[0], simulated=True).id


def decide(bench, identifier, points, who="somebody", number=2):
    stages = ScanStageRepository(bench.database)
    return stages.decide(identifier, number, points, who, lambda session, scan: None)


def is_asked(bench, identifier):
    stages = bench.scans.get(identifier).stages
    return stages[1]["state"] == "proposed" and bench.scans.get(identifier).state is S.PAUSED


def when_asked(bench, identifier, act):
    def watch():
        until(lambda: is_asked(bench, identifier), 60)
        act()

    bench.meanwhile(watch)


def test_stages_are_measured_one_after_the_other_with_the_laser_off_between(bench):
    identifier = queue(bench, points_of_interest=PLACES[:1])
    agreed = bench.scans.get(identifier).mask_id
    bench.work.run_once()
    row = bench.scans.get(identifier)
    assert bench.states(identifier) == [
        *("queued", "arming", "running", "pausing", "paused", "arming", "running", "completing", "complete")
    ]
    assert row.summary["stored"] == row.summary["points"] == row.summary["fired"]
    first, second = row.stages
    assert (first["state"], first["mask_id"], first["points"]) == ("made", agreed, 24)
    assert (second["state"], second["decided_by"]) == ("made", "plan")
    assert second["points_of_interest"] == [list(PLACES[0])]
    measured = bench.plans.load(row.measured_plan_id)
    with h5py.File(bench.data.scan_file(identifier)) as file:
        assert file["plan"].attrs["id"] == measured.id == second["plan_id"]
        assert file["mask"].attrs["id"] == row.mask_id == measured.mask.id == second["mask_id"]
    assert not has_further_stages(row)


def test_decision_of_a_person_is_taken_once(bench):
    identifier = queue(bench)
    when_asked(bench, identifier, lambda: decide(bench, identifier, PLACES[1:]))
    row = bench.scans.get(identifier)
    assert row.state is S.COMPLETE
    assert row.stages[1]["decided_by"] == "somebody"
    assert read_stages(bench.data.scan_file(identifier))[1].points_of_interest == PLACES[1:]
    assert decide(bench, identifier, PLACES[1:]).id == identifier, "repeating it has no effect"
    with pytest.raises(Conflict, match="made by somebody"):
        decide(bench, identifier, PLACES[:1])
    with pytest.raises(NotFound, match="stage"):
        decide(bench, identifier, PLACES, number=3)


def test_decision_before_the_survey_ends_needs_no_waiting(bench):
    identifier = queue(bench)
    decide(bench, identifier, PLACES[:1])
    bench.work.run_once()
    row = bench.scans.get(identifier)
    assert (row.state, row.stages[1]["decided_by"]) == (S.COMPLETE, "somebody")


def test_rule_decides_only_where_no_person_has(bench):
    identifier, stages = queue(bench), ScanStageRepository(bench.database)
    stages.decide_by_rule(identifier, 2, PLACES[:1])
    with pytest.raises(Conflict, match="decided by auto"):
        decide(bench, identifier, PLACES[1:])
    stages.decide_by_rule(identifier, 2, PLACES[1:])
    assert bench.scans.get(identifier).stages[1]["points_of_interest"] == [list(PLACES[0])]
    bench.scans.set_desired_state(identifier, W.ABORTED, "tested")
    bench.work.run_once()
    with pytest.raises(Conflict, match="aborted"):
        decide(bench, queue_and_abort(bench), PLACES[1:])


def queue_and_abort(bench):
    identifier = queue(bench)
    bench.scans.set_desired_state(identifier, W.ABORTED, "tested")
    bench.work.run_once()
    return identifier


@pytest.mark.long
def test_scan_stopped_while_it_waits_is_partial_and_can_be_completed(bench):
    earlier = queue(bench)
    when_asked(bench, earlier, lambda: bench.scans.set_desired_state(earlier, W.STOPPED, "lunch"))
    row = bench.scans.get(earlier)
    assert (row.state, row.summary["stored"], row.summary["points"]) == (S.PARTIAL, 24, 24)
    assert has_further_stages(row)
    with bench.database.write() as session:
        plan = bench.plans.get(row.plan_id)
        following = bench.scans.add(session, plan, simulated=True, completes=earlier).id
    when_asked(bench, following, lambda: decide(bench, following, PLACES[:1]))
    row = bench.scans.get(following)
    assert (row.state, row.completes) == (S.COMPLETE, earlier)
    assert row.summary["stored"] == row.summary["points"] > 24


@pytest.mark.long
def test_scan_paused_while_it_waits_goes_on_after_both_wishes(bench):
    identifier = queue(bench)

    def act():
        bench.scans.set_desired_state(identifier, W.PAUSED, "a visitor")
        decide(bench, identifier, PLACES[:1])
        time.sleep(1.0)
        assert bench.scans.get(identifier).stages[1]["state"] == "decided", "paused: nothing is begun"
        bench.scans.set_desired_state(identifier, W.RUNNING, "gone")

    when_asked(bench, identifier, act)
    assert bench.scans.get(identifier).state is S.COMPLETE


@pytest.mark.long
def test_scan_interrupted_while_it_waits_asks_again_after_it_is_resumed(bench):
    identifier = queue(bench)
    when_asked(bench, identifier, bench.stopping.set)
    assert bench.scans.get(identifier).state is S.INTERRUPTED
    bench.stopping.clear()
    decide(bench, identifier, PLACES[:1])
    bench.scans.set_desired_state(identifier, W.RUNNING, "the service is back")
    bench.work.run_once()
    row = bench.scans.get(identifier)
    assert row.state is S.COMPLETE
    assert row.summary["stored"] == row.summary["points"]
    assert [stage["state"] for stage in row.stages] == ["made", "made"]


@pytest.mark.long
def test_choice_that_cannot_be_measured_interrupts_and_another_one_is_taken(bench):
    identifier = queue(bench)
    too_deep = [(0.0, 0.0, 9e-3)]
    when_asked(bench, identifier, lambda: decide(bench, identifier, too_deep))
    row = bench.scans.get(identifier)
    assert (row.state, row.error_code) == (S.INTERRUPTED, "scan-interrupted")
    assert "cannot be measured around" in row.error
    decide(bench, identifier, PLACES[:1])
    bench.scans.set_desired_state(identifier, W.RUNNING, "another place")
    bench.work.run_once()
    assert bench.scans.get(identifier).state is S.COMPLETE


@pytest.mark.long
def test_survey_of_a_yarn_finds_it_and_the_focus_follows(bench):
    plan = ScanPlan.create(mask=equi_steradian_mask(APERTURE, 3.6e-3, 1600), samples=512, sampling_interval=16e-9)
    plan = plan_in_stages(plan, 200)
    MaskRepository(bench.database).put(plan.mask)
    identifier = bench.scans.queue(bench.plans.put(plan)[0], simulated=True).id
    bench.work.run_once()
    row = bench.scans.get(identifier)
    assert row.state is S.COMPLETE
    place = row.stages[1]["points_of_interest"][0]
    assert row.stages[1]["proposals"][0]["position"] == place
    assert np.linalg.norm(by_name("yarn").centres - place, axis=1).min() < 1e-3, "on the yarn"
    assert read_stages(bench.data.scan_file(identifier))[1].decided_by == "auto"


def test_plan_and_mask_of_a_made_stage_are_kept_for_the_scan(bench):
    identifier = queue(bench, points_of_interest=PLACES[:1])
    bench.work.run_once()
    row = bench.scans.get(identifier)
    with bench.database.write() as session:
        for resource in (Resource("plan", row.measured_plan_id), Resource("mask", row.mask_id)):
            assert Resource("scan", identifier) in lock_dependents(session, resource)


def test_stage_that_a_killed_process_did_not_report_is_taken_from_the_file(bench, monkeypatch):
    identifier = queue(bench, points_of_interest=PLACES[:1])
    monkeypatch.setattr(DatabaseControl, "on_stages", lambda self, stages, plan: None)
    bench.work.run_once()
    row = bench.scans.get(identifier)
    assert (row.state, [stage["state"] for stage in row.stages]) == (S.COMPLETE, ["made", "made"])
    with h5py.File(bench.data.scan_file(identifier)) as file:
        assert row.mask_id == file["mask"].attrs["id"]
    with pytest.raises(Conflict, match="made"):
        decide(bench, identifier, PLACES[1:])
