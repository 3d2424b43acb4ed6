"""A preview tells of a mask or plan what it would be, as figures or as a picture, and keeps nothing."""

import io

import matplotlib.image
import pytest

from steradian.masks import equi_steradian_mask, grid_mask
from steradian.masks.metrics import evaluate_mask
from steradian.plans import ScanPlan, preview_excitation

from .conftest import EQUI

MASK = EQUI | {"count": 75}
PNG = {"Accept": "image/png"}


@pytest.fixture
def bodies(mask):
    return {"masks": MASK, "plans": {"mask_id": mask["id"], "samples": 333}}


def pixels(answer):
    assert (answer.status_code, answer.headers["content-type"]) == (200, "image/png")
    return matplotlib.image.imread(io.BytesIO(answer.content))


def kept(server, http, noun):
    newest = [one["id"] for one in http.get(f"/{noun}", params={"limit": 1000}).json()["items"]]
    return newest, sorted(path for path in server.data.root.rglob("*.png"))


@pytest.mark.long
def test_mask_preview_equals_library_evaluation(http):
    told = http.post("/masks/preview", json=MASK).json()
    own = equi_steradian_mask(13.56e-3, 3.6e-3, 75)
    seen = evaluate_mask(own)
    assert (told["id"], told["count"]) == (own.id, own.count)
    assert http.get(f"/masks/{own.id}").status_code == 404
    for name in ("finest", "coarsest", "evenness", "largest_angle", "opening_angle", "attenuation_db", "weight_ratio"):
        assert told[name] == pytest.approx(getattr(seen, name)), name
    assert told["point_of_interest"] == pytest.approx(seen.point_of_interest)
    assert told["sensed_area"] == pytest.approx(own.sensed_area)


def test_mask_preview_without_point_of_interest_omits_dependent_values(http):
    grid = {"arrangement": "grid", "aperture": 0.01, "count": 5, "interval": 1e-3}
    told = http.post("/masks/preview", json=grid).json()
    assert (told["finest"], told["coarsest"]) == (pytest.approx(1e-3), pytest.approx(1e-3))
    assert told["point_of_interest"] is told["evenness"] is told["largest_angle"] is None


@pytest.mark.long
@pytest.mark.parametrize("noun", ["masks", "plans"])
def test_preview_returns_figures_or_png_by_accept_and_stores_nothing(server, http, bodies, noun):
    before = kept(server, http, noun)
    figures = http.post(f"/{noun}/preview", json=bodies[noun])
    assert (figures.headers["content-type"], figures.headers["vary"]) == ("application/json", "Accept")
    assert pixels(http.post(f"/{noun}/preview", json=bodies[noun], headers=PNG)).std() > 0.05
    assert kept(server, http, noun) == before
    refused = http.post(f"/{noun}/preview", json=bodies[noun], headers={"Accept": "text/csv"})
    assert (refused.status_code, refused.json()["code"]) == (406, "not-acceptable")


def test_mask_preview_returns_same_errors_as_mask_creation(http):
    for wrong in ({"depth": -1}, {"count": 5001}, {"colour": 1}):
        refused = http.post("/masks/preview", json=MASK | wrong, headers=PNG)
        assert (refused.status_code, refused.json()) == (422, refused.json())
        made = http.post("/masks", json=MASK | wrong).json()
        assert refused.json()["errors"] == made["errors"]


@pytest.mark.long
def test_multi_beam_plan_stores_mask_of_measured_points(http, mask):
    beams = [[0, 0], [8e-4, 0], [0, 8e-4], [8e-4, 8e-4]]
    wanted = {"mask_id": mask["id"], "beams": beams, "places": 30}
    preview = http.post("/plans/preview", json=wanted).json()
    assert (preview["beams"], preview["total_seconds"]) == (4, pytest.approx(30 / 50))
    assert 0 < preview["displacement"]["median"] < preview["displacement"]["largest"]
    made = http.post("/plans", json=wanted)
    assert made.status_code == 201
    plan = made.json()
    assert plan["beams"] == beams
    assert plan["mask_id"] != mask["id"]
    covered = http.get(f"/masks/{plan['mask_id']}").json()
    assert (covered["count"], covered["arrangement"]["of"]) == (120, mask["id"])
    assert http.post("/plans", json=wanted).status_code == 200
    wrong = http.post("/plans", json=wanted | {"beams": [[1e-3, 0]]})
    assert (wrong.status_code, wrong.json()["errors"][0]["pointer"]) == (422, "#/beams/0")


def test_preview_of_several_wavelengths_has_the_expected_error_of_oxygen_saturation(http):
    mask = http.post("/masks", json={"arrangement": "equi-steradian", "aperture": 0.01, "depth": 0.004, "count": 40})
    asked = {"mask_id": mask.json()["id"], "samples": 64, "frames": 4, "excitation": [750e-9, 800e-9, 850e-9]}
    told = http.post("/plans/preview", json=asked).json()["oxygenation"]
    found = preview_excitation(
        ScanPlan.create(mask=grid_mask(0.01, 5, 1e-3), samples=64, frames=4, excitation=asked["excitation"]),
        depth=0.004,
    )
    assert told["depth"] == 0.004
    assert told["noise"] == pytest.approx(0.03 / 2), "of four frames"
    assert told["saturation_error"] == pytest.approx(found.saturation_error)
    once = http.post("/plans/preview", json=asked | {"frames": 1}).json()["oxygenation"]
    assert once["saturation_error"] == pytest.approx(2 * told["saturation_error"], rel=0.01)
    assert http.post("/plans/preview", json=asked | {"excitation": []}).json()["oxygenation"] is None
