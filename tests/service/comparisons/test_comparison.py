"""Masks on equal terms: figures against closed forms, and who wins where."""

import json
import re

import numpy as np
import pytest
from typer.testing import CliRunner

import steradian
from steradian import InvalidInput
from steradian.cli.mask import app
from steradian.comparisons import Simulation, compare_masks, evaluate, phantom
from steradian.core.exceptions import Cancelled
from steradian.imaging import Volume, VoxelAxes
from steradian.masks import equiangular_mask, mask_by_count, write_mask
from steradian.masks.metrics import evaluate_mask
from steradian.phantoms import Balls, rasterise

APERTURE, DEPTH = 6e-3, 1.5e-3
POINT = (0.0, 0.0, DEPTH)
STERADIAN, GRID = (mask_by_count(name, APERTURE, 300, depth=DEPTH) for name in ("equi-steradian", "grid"))


@pytest.fixture(scope="module")
def vessels():
    """A tree of vessels that fills a field four times as wide as it is deep, through both masks."""
    return compare_masks(
        {"steradian": STERADIAN, "grid": GRID}, phantom=phantom("vessels", POINT), modes=60, iterations=3
    )


@pytest.mark.long
def test_an_equi_steradian_mask_wins_around_its_point_and_loses_the_wide_field(vessels):
    """Directly reconstructed; correlations of the volumes."""
    near, wide = (dict(vessels.ranking(region, "direct")) for region in ("around", "field"))
    assert near["steradian"] > near["grid"] + 0.03
    assert wide["grid"] > wide["steradian"] + 0.01
    assert vessels.as_json()["winners"]["direct"] == {"around": "steradian", "field": "grid"}


@pytest.mark.long
def test_a_mask_of_another_aperture_is_judged_by_the_object_on_its_own_voxels():
    thing = Balls(np.array([[0.5e-3, 0.0, 1.5e-3]]), np.array([120e-6]), np.array([1.0]))
    shared = Simulation(thing, (0.0, 0.0), 3e-3, None, 40, iterations=0)
    for aperture in (4e-3, 6e-3):
        mask = mask_by_count("grid", aperture, 100, depth=DEPTH)
        alone = Simulation(thing, (0.0, 0.0), 3e-3, None, 40, iterations=0).simulate(mask)
        found = shared.simulate(mask)
        np.testing.assert_array_equal(found.truth_mip, alone.truth_mip)
        assert found.by["direct"].field == alone.by["direct"].field


@pytest.mark.long
def test_iterations_bring_both_closer_to_the_object(vessels):
    for region in ("around", "field"):
        direct, iterative = (dict(vessels.ranking(region, method)) for method in ("direct", "iterative"))
        assert all(iterative[name] > direct[name] + 0.05 for name in direct)


def test_mask_figures_match_closed_forms(vessels):
    """Directions: the solid angle of a square plate over its middle; time: a pulse a point; distances of a grid."""
    grid, steradian_ = vessels.promised["grid"], vessels.promised["steradian"]
    half = APERTURE / 2
    assert grid.view == pytest.approx(4 * np.arcsin(half**2 / (half**2 + DEPTH**2)) / (2 * np.pi), rel=0.02)
    assert grid.seconds == pytest.approx(GRID.count / 50)
    assert grid.finest_m == pytest.approx(APERTURE / 17)
    corner = 8 * APERTURE / 17
    assert grid.steepest_deg == pytest.approx(np.degrees(np.arctan(np.sqrt(2) * corner / DEPTH)))
    # in solid angle cells of one size differ as cos³ of the angle of incidence does
    cosine = DEPTH / np.hypot(np.linalg.norm(GRID.positions, axis=1), DEPTH)
    angles = evaluate_mask(GRID, POINT).solid_angles
    np.testing.assert_allclose(angles / angles.mean(), cosine**3 / (cosine**3).mean(), rtol=1e-6)
    assert steradian_.solid_angle_spread < grid.solid_angle_spread / 2
    assert steradian_.travel_m > 0.9 * STERADIAN.count * steradian_.finest_m


def test_the_spread_of_solid_angles_is_the_evenness_that_mask_and_page_tell(vessels, tmp_path):
    for name, mask in (("grid", GRID), ("steradian", STERADIAN)):
        assert vessels.promised[name].solid_angle_spread == evaluate_mask(mask, POINT).evenness
    size = ("--aperture", "6mm", "--depth", "1.5mm")
    words = ("equi-steradian", *size, "--count", "309", "-o", str(tmp_path / "mask.json"))
    told = CliRunner().invoke(app, words, catch_exceptions=False).output
    compared = run("equi-steradian:309", "grid:289", *size).output
    spread = re.search(r"varies by ([\d.]+ %) within the rim", told)[1]
    assert re.search(r"solid angles vary \(rim\) +([\d.]+ %)", compared)[1] == spread


def test_noise_takes_contrast_from_the_ball_and_likeness_from_the_object():
    quiet, loud = (evaluate(GRID, POINT, noise=noise)[0] for noise in (80.0, 5.0))
    assert quiet.contrast_db > loud.contrast_db + 3
    thing = phantom("vessels", POINT)
    silent, some, much = (
        Simulation(thing, (0.0, 0.0), 3e-3, noise, 40, iterations=0).simulate(GRID).by["direct"].field
        for noise in (None, 30.0, 0.0)
    )
    assert silent > some > much + 0.05


def test_a_volume_is_seen_like_the_balls_it_shows():
    """Balls have a closed form, a volume goes through the forward model: both make the same of a mask."""
    balls = Balls(np.array([[0.4e-3, 0.0, 1.4e-3], [-1e-3, 0.8e-3, 1.7e-3]]), np.full(2, 150e-6), np.ones(2))
    step, x = 24e-6, (np.arange(60) - 30) * (APERTURE / 60)
    frame = Volume(
        np.zeros((60, 60, 120), np.float32), VoxelAxes(x, x, step * np.arange(120)), (APERTURE / 60,) * 2 + (step,)
    )
    outcomes = []
    for thing in (balls, rasterise(balls, frame)):
        simulation = Simulation(thing, (0.0, 0.0), 3e-3, None, 60, iterations=0)
        outcomes.append(simulation.simulate(GRID).by["direct"])
    assert outcomes[0].field_mip == pytest.approx(outcomes[1].field_mip, abs=0.01)
    assert outcomes[0].around_mip == pytest.approx(outcomes[1].around_mip, abs=0.01)
    with pytest.raises(InvalidInput, match="of the aperture"):
        Simulation(rasterise(balls, frame), (0.0, 0.0), 3e-3).simulate(mask_by_count("grid", 2 * APERTURE, 100))


def test_mask_comparison_reports_progress_and_can_be_cancelled():
    told = []
    masks = {"a": GRID, "b": STERADIAN}
    compare_masks(masks, progress=lambda *words: told.append(words))
    assert [words for words in told if words[0] == "masks"] == [("masks", 0, 2), ("masks", 1, 2), ("masks", 2, 2)]
    with pytest.raises(Cancelled):
        compare_masks(masks, phantom=phantom("yarn", POINT), cancelled=lambda: len(told) > 0)


@pytest.mark.parametrize(
    ("masks", "options", "field"),
    [
        ({"a": GRID}, {}, "masks"),
        ({"a": GRID, "b": equiangular_mask(1e-2, 1e-3, 9)}, {}, "masks[b]"),
        ({"a": steradian.grid_mask(1e-2, 3, 1e-3), "b": steradian.grid_mask(1e-2, 4, 1e-3)}, {}, "point_of_interest"),
        ({"a": GRID, "b": GRID}, {"point_of_interest": (0.0, 0.0, -1e-3)}, "point_of_interest"),
        ({"a": GRID, "b": GRID}, {"phantom": phantom("yarn", POINT), "region": -1.0}, "region"),
        ({"a": GRID, "b": GRID}, {"phantom": phantom("yarn", POINT), "iterations": -1}, "iterations"),
    ],
)
def test_nonsense_is_refused(masks, options, field):
    with pytest.raises(InvalidInput) as refused:
        compare_masks(masks, **options)
    assert refused.value.field == field


@pytest.mark.parametrize(("name", "radius", "field"), [("cat", None, "phantom"), ("yarn", 9e-3, "phantom_radius")])
def test_phantoms_stay_off_the_film(name, radius, field):
    with pytest.raises(InvalidInput) as refused:
        phantom(name, POINT, radius)
    assert refused.value.field == field
    assert phantom("vessel-tree", POINT).centres[:, 2].min() > 0


def test_phantom_by_its_name_of_before_is_the_same_object():
    """The simulated scanner has another object called vessels."""
    np.testing.assert_array_equal(phantom("vessels", POINT).centres, phantom("vessel-tree", POINT).centres)
    with pytest.raises(InvalidInput, match="allowed: vessel-tree, yarn or a volume file"):
        phantom("cat", POINT)


def run(*words):
    return CliRunner().invoke(app, ["compare", *map(str, words)], catch_exceptions=False)


@pytest.mark.long
def test_the_command_takes_files_and_arrangements_and_prints_table_or_json(tmp_path):
    write_mask(STERADIAN, tmp_path / "mine.json")
    words = (tmp_path / "mine.json", "grid:289", "random", "--aperture", "6mm", "--depth", "1.5mm", "--count", 200)
    done = run(*words, "--plot", tmp_path / "c.png")
    assert done.exit_code == 0
    for text in (
        "mine",
        "grid:289",
        "random",
        "solid angles vary (rim)",
        "expected contrast",
        "time at 50 Hz",
        "c.png",
    ):
        assert text in done.output
    assert (tmp_path / "c.png").read_bytes()[:4] == b"\x89PNG"
    told = json.loads(run(*words, "--json").output)
    assert {name: row["points"] for name, row in told["masks"].items()} == {"mine": 309, "grid:289": 289, "random": 200}
    assert told["point_of_interest_m"] == [0, 0, DEPTH]


def test_a_picture_of_an_unknown_kind_is_refused_before_any_work(tmp_path):
    for name, allowed in (("x.bmp", "png"), ("c.csv", "svg")):
        with pytest.raises(InvalidInput, match=rf"plot.*{name}.*{allowed}"):
            run(tmp_path / "no-such-mask.json", "--plot", tmp_path / name)


@pytest.mark.long
def test_compare_command_names_best_mask_per_criterion():
    words = ("equi-steradian", "grid", "--aperture", "6mm", "--depth", "1.5mm", "--count", 300)
    done = run(*words, "--phantom", "vessel-tree", "--modes", 60, "--iterations", 0)
    assert "direct, around the point of interest: equi-steradian wins" in done.output
    assert "direct, whole field: grid wins" in done.output


@pytest.mark.parametrize("wrong", [["spiral"], ["grid:many"], ["grid", "absent.json"]])
def test_compare_command_refuses_invalid_mask(wrong):
    with pytest.raises(InvalidInput, match="masks"):
        run(*wrong)
