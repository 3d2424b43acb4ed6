"""Scans that a stopping rule ends: limits of the rule, and the points that are measured."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from staged_bench import APERTURE, KnownPlanner, staged_plan

from fabry_perot.simulator import launch
from steradian.core.exceptions import InvalidInput
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.plans.stages import StoppingRule
from steradian.scans.acquisition.run import resume_scan, run_scan
from steradian.scans.acquisition.session_control import SessionOutcome
from steradian.scans.file.read import list_frames


@pytest.fixture(scope="module")
def port():
    with launch(speed=200.0) as simulator:
        yield simulator.url


def test_stopping_rule_needs_parts_that_can_be_compared():
    with pytest.raises(InvalidInput, match="progressive"):
        staged_plan(stopping=StoppingRule())
    with pytest.raises(InvalidInput, match="frames"):
        staged_plan(order="progressive", frames=2, stopping=StoppingRule())


class Judge(KnownPlanner):
    """A planner whose images are enough once so many A-lines are stored."""

    count = 26

    def enough(self, path, plan):
        return "enough" if list_frames(path)[0].stored >= self.count else ""


@pytest.mark.long
def test_stopping_rule_ends_the_scan_with_every_fired_aline_stored(tmp_path):
    plan = staged_plan(order="progressive", pulse_rate=5.0, stopping=StoppingRule())
    with launch(speed=1.0) as simulator:
        summary = run_scan(plan, simulator.url, tmp_path / "scan.h5", planner=Judge())
    assert summary.end is SessionOutcome.ENOUGH
    assert Judge.count <= summary.stored == summary.fired < summary.points


def test_no_more_points_are_measured_than_the_stopping_rule_allows(port, tmp_path):
    """Whatever becomes of the judgement of images."""

    class Failing(KnownPlanner):
        def enough(self, path, plan):
            raise RuntimeError("no image")

    rule = StoppingRule(max_points=30)
    for number, plan in enumerate((staged_plan(order="progressive", stopping=rule), even_plan(stopping=rule))):
        summary = run_scan(plan, port, tmp_path / f"{number}.h5", planner=Failing())
        assert (summary.end, summary.stored, summary.fired) == (SessionOutcome.ENOUGH, 30, 30)
        resumed = resume_scan(tmp_path / f"{number}.h5", port, planner=Failing())
        assert resumed.stored == 30


def even_plan(**parameters):
    return ScanPlan.create(
        mask=equi_steradian_mask(APERTURE, 3.6e-3, 60), samples=384, order="progressive", **parameters
    )


def test_limits_of_a_stopping_rule_must_agree():
    with pytest.raises(InvalidInput, match="min_points"):
        StoppingRule.create(min_points=50, max_points=40)
    with pytest.raises(InvalidInput, match="max_points"):
        staged_plan(order="progressive", stopping=StoppingRule(max_points=24))
