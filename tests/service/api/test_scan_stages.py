"""Stages of scans over HTTP: planned with a survey, decided by a person once, and bad choices refused by name."""

import pytest

from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import ScanState
from steradian_client.models import Plan

from .conftest import make_scan

PLACE = [2e-3, -1.5e-3, 2.5e-3]


@pytest.fixture
def scan(http, mask):
    """A queued scan of a survey of 24 points and a focus of some 29."""
    survey = {"points": 24, "decision": "ask"}
    plan = http.post("/plans", json={"mask_id": mask["id"], "samples": 384, "survey": survey})
    assert plan.status_code in (200, 201), plan.text
    return make_scan(http, plan.json()["id"]).json()


def decide(http, scan, number=2, **body):
    return http.put(f"/scans/{scan['id']}/stages/{number}", json=body)


def test_plan_with_survey_tells_its_stages_and_counts_all_their_points(http, scan):
    plan = http.get(f"/plans/{scan['plan_id']}").json()
    (stage,) = plan["stages"]
    mask = http.get(f"/masks/{plan['mask_id']}").json()
    assert (mask["arrangement"]["arrangement"], mask["count"]) == ("poisson-disc", 24)
    assert (stage["points"], stage["decision"]) == (29, "ask")
    assert plan["preview"]["seconds"]["laser"] == pytest.approx((24 + 29) / plan["pulse_rate"])
    assert [each["state"] for each in scan["stages"]] == ["made", "planned"]
    assert scan["stages"][1]["points"] == 29


def test_python_client_reads_a_plan_with_a_stopping_rule(http, mask):
    wanted = {"mask_id": mask["id"], "order": "progressive", "stopping": {"max_points": 40}}
    said = http.post("/plans", json=wanted | {"samples": 384, "survey": {"points": 24}}).json()
    plan = Plan.model_validate(said)
    assert (plan.stopping["max_points"], plan.stages[0]["points"]) == (40, 29)
    assert plan.preview["seconds"]["laser"] == pytest.approx(40 / plan.pulse_rate)


def test_scan_of_one_stage_has_no_stages(http, plan):
    assert make_scan(http, plan["id"]).json()["stages"] is None


def test_choice_in_advance_is_kept_and_another_one_conflicts(http, scan):
    answer = decide(http, scan, points_of_interest=[PLACE])
    assert answer.status_code == 200, answer.text
    stage = answer.json()["stages"][1]
    assert (stage["state"], stage["points_of_interest"]) == ("decided", [PLACE])
    assert stage["decided_by"]
    assert decide(http, scan, points_of_interest=[PLACE]).status_code == 200, "repeating it has no effect"
    conflict = decide(http, scan, points_of_interest=[[0, 0, 3e-3]])
    assert (conflict.status_code, conflict.json()["code"]) == (409, "conflict")


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ({"points_of_interest": [[9e-3, 0, 3e-3]]}, "over the aperture"),
        ({"points_of_interest": [[0, 0, 0]]}, "> 0 and less than"),
        ({"points_of_interest": [[0, 0, 50e-3]]}, "> 0 and less than"),
        ({"points_of_interest": 9 * [PLACE]}, "8"),
        ({"proposals": [1]}, "none yet"),
        ({}, "points_of_interest or proposals"),
        ({"points_of_interest": [PLACE], "proposals": [1]}, "points_of_interest or proposals"),
    ],
)
def test_bad_choice_is_refused_and_nothing_is_decided(http, scan, body, says):
    answer = decide(http, scan, **body)
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid-input")
    assert says in answer.text
    assert http.get(f"/scans/{scan['id']}").json()["stages"][1]["state"] == "planned"


def test_stage_that_is_none_is_not_found(http, scan, plan):
    assert decide(http, scan, number=3, points_of_interest=[PLACE]).status_code == 404
    other = make_scan(http, plan["id"]).json()
    assert decide(http, other, points_of_interest=[PLACE]).status_code == 404


def test_choice_for_a_scan_that_has_ended_conflicts(server, http, scan):
    ScanRepository(server.database).transition(scan["id"], ScanState.ABORTED, why="test")
    answer = decide(http, scan, points_of_interest=[PLACE])
    assert (answer.status_code, answer.json()["code"]) == (409, "conflict")


@pytest.mark.parametrize(
    ("wanted", "field"),
    [
        ({"survey": {"points": 60}}, "survey"),
        ({"survey": {"points": 24}, "beams": [[0, 0], [8e-4, 0]]}, "stages"),
        ({"survey": {"points": 24}, "stopping": {}}, "order"),
        ({"survey": {"points": 24, "choice": "nearest", "count": 3}}, "count"),
        ({"stopping": {"max_gain": 2}, "order": "progressive"}, "max_gain"),
    ],
)
def test_bad_plan_in_stages_names_the_field(http, mask, wanted, field):
    answer = http.post("/plans", json={"mask_id": mask["id"], "samples": 384} | wanted)
    assert answer.status_code == 422
    assert field in answer.text
