"""A design tells of a mask and a plan together what they would be, from any place, and keeps nothing."""

import numpy as np
import pytest

from steradian import design_scan
from steradian.masks import equi_steradian_mask
from steradian.masks.metrics import evaluate_mask
from steradian.masks.point_spread import point_spread
from steradian.plans import ScanPlan, preview

from .conftest import EQUI

MASK = EQUI | {"count": 75}
HOW = {"pulse_rate": 40, "samples": 333, "order": "hilbert"}
PLACE = (1e-3, -5e-4, 2.5e-3)


@pytest.fixture(scope="module")
def own():
    return equi_steradian_mask(13.56e-3, 3.6e-3, 75)


@pytest.mark.long
def test_design_preview_equals_library_mask_and_plan(http, own):
    told = http.post("/designs/preview", json={"arrangement": MASK, "point": PLACE, **HOW}).json()
    plan, seen = ScanPlan.create(mask=own, **HOW), evaluate_mask(own, PLACE)
    assert np.array(told["positions"]) == pytest.approx(own.film_positions)
    assert np.array(told["weights"]) == pytest.approx(own.weights)
    assert told["visit"] == plan.visit.tolist()
    assert told["plan"]["total_seconds"] == pytest.approx(preview(plan).total_seconds)
    assert told["mask"]["id"] == own.id
    assert told["mask"]["point_of_interest"] == pytest.approx(PLACE)
    assert told["mask"]["largest_angle"] == pytest.approx(seen.largest_angle)
    assert np.array(told["solid_angles"]) == pytest.approx(seen.solid_angles)
    assert http.get(f"/masks/{own.id}").status_code == 404


def test_the_share_of_visible_edges_is_that_of_directions_that_meet_the_sensors(http, own):
    """Against a count: of a hundred thousand directions by chance, those whose line meets the disc of the sensors."""
    told = http.post("/designs/preview", json={"arrangement": MASK, "point": PLACE}).json()
    normal = np.random.default_rng(3).normal(size=(100_000, 3))
    meets = np.array(PLACE[:2]) - normal[:, :2] / normal[:, 2:] * PLACE[2]
    radius = np.sqrt(own.weights.sum() / np.pi)
    share = (np.hypot(*(meets - own.offset).T) < radius).mean()
    assert told["visible_share"] == pytest.approx(share, abs=0.01)


def test_design_preview_without_point_of_interest_omits_dependent_values(http):
    grid = {"arrangement": "grid", "aperture": 0.01, "count": 5, "interval": 1e-3}
    told = http.post("/designs/preview", json={"arrangement": grid}).json()
    assert told["solid_angles"] is told["visible_share"] is told["mask"]["evenness"] is None
    assert len(told["visit"]) == len(told["positions"]) == 25


@pytest.mark.long
def test_a_point_spread_is_the_librarys(http, own):
    told = http.post("/designs/point-spread", json={"arrangement": MASK, "point": PLACE, "width": 3e-4}).json()
    seen = point_spread(own, PLACE, width=3e-4)
    assert (told["lateral"], told["axial"]) == (pytest.approx(seen.lateral), pytest.approx(seen.axial))
    assert np.array(told["section"]) == pytest.approx(seen.section, abs=1e-6)
    assert np.shape(told["section"]) == (len(told["x"]), len(told["z"]))


@pytest.mark.parametrize(
    ("change", "pointer"),
    [
        ({"arrangement": MASK | {"depth": -1}}, "#/arrangement/depth"),
        ({"arrangement": MASK | {"offset": [1, 0]}}, "#/arrangement/offset"),
        ({"arrangement": MASK | {"colour": "red"}}, "#/arrangement/colour"),
        ({"arrangement": {"arrangement": "spiral"}}, "#/arrangement/arrangement"),
        ({"point": [0, 0, -1e-3]}, "#/point/2"),
        ({"pulse_rate": 0}, "#/pulse_rate"),
        ({"pulse_rate": 9000, "samples": 65_536}, "#/pulse_rate"),
    ],
)
def test_design_preview_invalid_field_returns_422_with_pointer(http, change, pointer):
    answer = http.post("/designs/preview", json={"arrangement": MASK} | change)
    assert answer.status_code == 422
    assert [finding["pointer"] for finding in answer.json()["errors"]] == [pointer]


BUDGET = {"arrangement": "grid", "duration": 20, "pulse_rate": 50, "aperture": 5e-3, "depth": 1.5e-3, "vessel": 1.5e-4}


@pytest.mark.long
def test_a_budget_is_the_librarys(http):
    told = http.post("/designs/budget", json=BUDGET | {"noise": 20, "averages": [2, 10]}).json()
    (dense,) = [split for split in told["splits"] if split["averages"] == 2]
    own = design_scan(
        time=20, noise=20.0, pulse_rate=50, aperture=5e-3, depth=1.5e-3, vessel=1.5e-4, modes=83, averages=[2, 10],
        arrangements=("grid",), methods=("direct",),
    )  # fmt: skip
    assert (told["pulses"], told["modes"], len(told["splits"])) == (1000, 83, 2)
    assert dense["contrast_db"] == pytest.approx(own.splits[-1].expected.contrast_db)
    assert dense["width"] == pytest.approx(own.splits[-1].expected.width)
    assert [split["proposed"] for split in told["splits"]] == [split is own.chosen for split in own.splits]


@pytest.mark.parametrize(
    ("change", "pointer"),
    [
        ({}, "#/noise"),
        ({"noise": 20, "scan_id": "s1"}, "#/noise"),
        ({"noise": 20, "arrangement": "spiral"}, "#/arrangement"),
        ({"noise": 20, "averages": []}, "#/averages"),
        ({"noise": 20, "averages": [900]}, "#/averages"),
        ({"noise": 20, "duration": 0.5}, "#/duration"),
        ({"noise": 20, "method": "iterative"}, "#/averages"),
        ({"noise": 20, "method": "iterative", "averages": [2, 3, 4]}, "#/averages"),
        ({"noise": 20, "duration": 200, "sampling_interval": 1e-10}, "#/sampling_interval"),
        ({"noise": 20, "vessel": 2e-3, "depth": 9e-4}, "#/vessel"),
        ({"noise": 20, "offset": [0.02, 0]}, "#/offset"),
    ],
)
def test_a_budgets_invalid_field_returns_422_with_pointer(http, change, pointer):
    answer = http.post("/designs/budget", json=BUDGET | change)
    assert answer.status_code == 422
    assert [finding["pointer"] for finding in answer.json()["errors"]] == [pointer]


def test_a_budget_from_a_scan_without_noise_names_the_scan(http, scan_with_alines):
    answer = http.post("/designs/budget", json=BUDGET | {"scan_id": scan_with_alines["scan"]["id"]})
    assert answer.status_code == 422
    (finding,) = answer.json()["errors"]
    assert finding["pointer"] == "#/scan_id"
    assert "without noise" in finding["detail"]


def test_a_budget_from_an_unknown_scan_is_not_found(http):
    assert http.post("/designs/budget", json=BUDGET | {"scan_id": "s000000000000000000000000"}).status_code == 404
