"""``--survey``, ``--focus`` and ``--enough``: what they accept, and a scan in stages from the command line."""

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from fabry_perot.simulator import launch
from steradian.cli.app import app
from steradian.cli.stage_options import describe_proposal, parse_choice, parse_focus, plan_with_stages
from steradian.core.exceptions import InvalidInput, ScanInterrupted
from steradian.masks import equi_steradian_mask
from steradian.plans import ScanPlan
from steradian.plans.files import read_json, write_json
from steradian.plans.stages import Proposal
from steradian.scans.file.stages import read_stages

PLACE = (2e-3, -1.5e-3, 2.5e-3)
PROPOSALS = tuple(Proposal(position=(x, 0.0, 2e-3), signal_to_noise=30.0) for x in (1e-3, -1e-3))


@pytest.fixture(scope="module")
def plan():
    return ScanPlan.create(mask=equi_steradian_mask(13.56e-3, 3.6e-3, 60), samples=384)


@pytest.mark.parametrize(
    ("said", "fields"),
    [
        (None, {"decision": "auto"}),
        (["ask"], {"decision": "ask"}),
        (["nearest"], {"choice": "nearest"}),
        (["several:3"], {"choice": "several", "count": 3}),
        (["2mm,-1.5mm, 2500um"], {"points_of_interest": (pytest.approx(PLACE),)}),
        (["2mm,-1.5mm,2.5mm", "0mm,0mm,3mm"], {"points_of_interest": (pytest.approx(PLACE), (0, 0, 3e-3))}),
    ],
)
def test_focus_option_is_a_rule_or_places(said, fields):
    assert parse_focus(said) == fields


@pytest.mark.parametrize(
    "said",
    [["far"], ["several:"], ["several:x"], ["auto", "nearest"], ["1mm,2mm"], ["1mm,2mm,x"], ["auto", "1mm,2mm,3mm"]],
)
def test_other_focus_is_refused_with_what_is_allowed(said):
    with pytest.raises(InvalidInput, match=r"focus .* auto, nearest, several:N, ask, or a place"):
        parse_focus(said)


@pytest.mark.parametrize(("said", "chosen"), [("1", PROPOSALS[:1]), ("2, 1", PROPOSALS[::-1])])
def test_typed_numbers_choose_proposals(said, chosen):
    assert parse_choice(said, PROPOSALS) == tuple(each.position for each in chosen)


def test_typed_place_is_chosen_and_other_answers_are_refused():
    assert parse_choice("2mm,-1.5mm,2.5mm", PROPOSALS) == (pytest.approx(PLACE),)
    for said in ("3", "0", "here", "1.5"):
        with pytest.raises(InvalidInput, match="choice"):
            parse_choice(said, PROPOSALS)


def test_proposal_is_described_in_millimetres_and_micrometres():
    found = PROPOSALS[0].replace(promise={"lateral_m": 184.2e-6, "true_m": 150e-6})
    assert describe_proposal(found) == (
        "x 1.00 mm, y 0.00 mm, depth 2.00 mm, signal-to-noise 30; focused there, a ball of 150 µm is 184 µm wide"
        " in the image"
    )


def test_options_need_a_plan_of_one_stage(plan):
    with pytest.raises(InvalidInput, match="focus"):
        plan_with_stages(plan, None, ["auto"], None)
    staged = plan_with_stages(plan, 24, None, 0.01)
    assert (staged.order, staged.stopping.max_gain) == ("progressive", 0.01)
    with pytest.raises(InvalidInput, match="survey"):
        plan_with_stages(staged, 24, None, None)


def test_focus_replaces_the_rule_of_a_plan_in_stages(plan):
    staged = plan_with_stages(plan, 24, ["auto"], None)
    (stage,) = plan_with_stages(staged, None, ["ask"], None).stages
    assert (stage.decision, stage.points) == ("ask", staged.stages[0].points)
    with pytest.raises(InvalidInput, match="focus"):
        plan_with_stages(staged, None, ["far"], None)


def call(*words, raises=None):
    result = CliRunner().invoke(app, [str(word) for word in words])
    if raises is None:
        assert result.exception is None, result.output
        return result.output
    assert isinstance(result.exception, raises), result.exception
    return f"{result.output}{result.exception}"


def test_plan_command_prints_stages_and_a_range_of_times(plan, tmp_path):
    write_json(plan.mask, tmp_path / "mask.json")
    where = ("-o", tmp_path / "plan.json")
    said = call("plan", tmp_path / "mask.json", "--samples", 384, "--survey", 24, "--enough", 0.01, *where)
    assert "24 of a survey, then at most 29 focused on its image" in said
    assert "0.5 to 1." in said
    assert len(read_json(ScanPlan, tmp_path / "plan.json").stages) == 1


@pytest.mark.long
def test_scan_that_waits_without_a_terminal_is_kept_and_continued_around_a_place(plan, tmp_path):
    scan = tmp_path / "scan.h5"
    write_json(plan, tmp_path / "plan.json")
    with launch(speed=100.0) as simulator:
        how = ("--scanner", simulator.url)
        words = ("scan", "run", tmp_path / "plan.json", "--survey", 24, "--focus", "ask", "-o", scan, *how)
        said = call(*words, raises=ScanInterrupted)
        assert "stage 2 needs a point of interest" in said
        assert read_stages(scan) == ()
        said = call("scan", "resume", scan, "--focus", "2mm,-1.5mm,2.5mm", *how)
    assert "53 of 53 A-lines" in said
    with h5py.File(scan) as file:
        assert (np.asarray(file["alines/status"]) == 1).all()
    assert read_stages(scan)[1].points_of_interest == (pytest.approx(PLACE),)
