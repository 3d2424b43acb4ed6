"""Images of scans in stages: the followed image, the plan of a focus from a survey, and its replay."""

import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from staged_bench import PLACES, KnownPlanner, staged_plan

import steradian
from fabry_perot.simulator import launch
from steradian.core.exceptions import InvalidInput
from steradian.reconstructions.live.follow import LiveReconstruction
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.stages.planner import ChildStagePlanner, propose
from steradian.scans.acquisition.run import run_scan
from steradian.scans.file.create import create_scan_file
from steradian.scans.file.tail import IdleDetector


@pytest.fixture(scope="module")
def port():
    with launch(speed=200.0) as simulator:
        yield simulator.url


def test_followed_image_takes_up_the_points_of_a_further_stage(port, tmp_path):
    plan, path = staged_plan(), tmp_path / "scan.h5"
    parameters = ReconstructionParameters(modes=16)
    views = []

    def look(scan):
        views.append(LiveReconstruction(scan, tmp_path / "live", parameters))
        assert views[0].update().points == plan.mask.count
        assert not IdleDetector(scan, 100.0)(), "a further stage is to come"

    run_scan(plan, port, path, planner=KnownPlanner(looked=look))
    revision = views[0].update()
    fresh = LiveReconstruction(path, tmp_path / "fresh", parameters)
    fresh.update()
    assert (revision.number, revision.points) == (2, fresh.whole.planned)
    np.testing.assert_array_equal(views[0].volume().values, fresh.volume().values)
    assert IdleDetector(path, 100.0)()


def test_library_plans_the_focus_of_a_survey_that_another_program_measured(port, tmp_path):
    path = tmp_path / "survey.h5"
    first = steradian.survey(13.56e-3, 24, 29, plan={"samples": 384})
    run_scan(first.replace(stages=()), port, path)
    plan = steradian.focus(path, 29, points_of_interest=PLACES[:1])
    count = plan.stage_ends[-1]
    np.testing.assert_array_equal(plan.mask.positions[:count], first.mask.positions)
    assert count < plan.mask.count <= count + 29
    with pytest.raises(InvalidInput, match="points"):
        steradian.focus(path, points_of_interest=PLACES[:1])


@pytest.mark.long
def test_replay_from_the_file_gives_the_same_stages(tmp_path):
    """The survey's A-lines alone lead to the same proposals and the same mask again."""
    plan, path = (
        steradian.survey(13.56e-3, 200, 200, plan={"samples": 512, "sampling_interval": 16e-9}),
        tmp_path / "s.h5",
    )
    with launch(speed=200.0, phantom="yarn") as simulator, ChildStagePlanner() as planner:
        run_scan(plan, simulator.url, path, planner=planner)
    record = steradian.open(path).stages[1]
    survey = tmp_path / "survey.h5"
    create_scan_file(survey, plan)
    with h5py.File(path) as file, h5py.File(survey, "r+") as again:
        for name, column in file["alines"].items():
            again["alines"][name][:] = column[: plan.mask.count]
    with h5py.File(path) as file:
        replayed = steradian.focus(survey)
        assert replayed.id == record.plan_id == file["plan"].attrs["id"]
        np.testing.assert_array_equal(replayed.mask.positions, file["mask/positions"][:])
    assert propose(survey, plan.stages[0]) == record.proposals
