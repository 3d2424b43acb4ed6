"""Scan in stages as a candidate of the mask comparison, and images of halves of the sensors."""

import numpy as np
import pytest
from typer.testing import CliRunner

from steradian.cli.mask import app
from steradian.comparisons import Simulation, StagedScan, compare_masks
from steradian.core.exceptions import InvalidInput
from steradian.imaging import Acquisition, Compute, ImageGrid, Nufft, reconstruct
from steradian.imaging.half_images import half_images, morton_order
from steradian.masks import grid_mask, mask_by_count
from steradian.masks.staged import survey_mask
from steradian.phantoms import Balls, pressure

APERTURE, BALL = 6e-3, (1.2e-3, -0.6e-3, 1.5e-3)
THING = Balls(np.array([BALL]), np.array([120e-6]), np.array([1.0]))
SIMULATION = Simulation(THING, BALL[:2], 2e-3, iterations=0, modes=50)


@pytest.fixture(scope="module")
def built():
    return StagedScan(APERTURE, 200, 60).build(SIMULATION)


def test_staged_scan_finds_the_object_and_focuses_on_it(built):
    mask, found = built
    assert np.linalg.norm(np.subtract(found.position, BALL)) < 0.15e-3
    assert mask.count == 200
    assert np.linalg.norm(mask.points_of_interest[0] - BALL) < 0.15e-3
    assert abs(mask.arrangement["stage_ends"][0] - 60) <= 2


def test_staged_scan_of_nothing_spreads_all_points_evenly():
    nothing = Balls(np.array([BALL]), np.array([120e-6]), np.array([1e-9]))
    silent = Simulation(nothing, BALL[:2], 2e-3, -40.0, iterations=0, modes=50)
    mask, found = StagedScan(APERTURE, 150, 60).build(silent)
    assert found is None
    assert mask.arrangement["arrangement"] == "poisson-disc"
    assert mask.count == pytest.approx(150, abs=4)


@pytest.mark.long
def test_staged_scan_is_compared_as_a_mask():
    masks = {
        "guess": mask_by_count("equi-steradian", APERTURE, 200, depth=3e-3),
        "staged": StagedScan(APERTURE, 200, 60),
    }
    found = compare_masks(masks, point_of_interest=BALL, phantom=THING, region=2e-3, modes=50, iterations=0)
    near = dict(found.ranking("around", "direct"))
    assert near["staged"] > near["guess"] + 0.03
    assert found.masks["staged"].arrangement["arrangement"] == "staged"
    assert found.as_json()["masks"]["staged"]["arrangement"] == "staged"


@pytest.mark.parametrize(("count", "survey", "expected"), [(1600, None, 200), (500, None, 120), (200, None, 100)])
def test_survey_is_an_eighth_but_at_least_120_points_and_at_most_half(count, survey, expected):
    assert StagedScan(APERTURE, count, survey).survey_count == expected


@pytest.mark.parametrize(("count", "survey"), [(200, 15), (200, 196), (30, None)])
def test_staged_scan_refuses_a_survey_that_does_not_fit(count, survey):
    with pytest.raises(InvalidInput, match="survey"):
        StagedScan(APERTURE, count, survey).build(SIMULATION)


def test_staged_scan_without_an_object_is_refused():
    masks = {"grid": mask_by_count("grid", APERTURE, 100), "staged": StagedScan(APERTURE, 200, 60)}
    with pytest.raises(InvalidInput, match=r"masks\[staged\]"):
        compare_masks(masks, point_of_interest=BALL)
    refused = CliRunner().invoke(app, ["compare", "grid:100", "staged:200"])
    assert refused.exit_code != 0


def test_halves_are_interleaved_and_their_mean_is_the_image_of_all():
    mask = grid_mask(APERTURE, 12, 0.5e-3, centred=True)
    traces = pressure(THING, mask.positions, samples=192, sampling_interval=32e-9, sound_speed=1500.0)
    acquisition = Acquisition(traces, mask.positions, dt=32e-9, sound_speed=1500.0, aperture=APERTURE)
    grid, cpu = ImageGrid(24), Compute(device="cpu")
    one, other = half_images(acquisition, mask.outline, grid, compute=cpu)
    whole = reconstruct(acquisition, grid, Nufft(), compute=cpu)
    peak = np.unravel_index(np.abs(whole.values).argmax(), whole.values.shape)
    assert (one.values[peak] + other.values[peak]) / 2 == pytest.approx(whole.values[peak], rel=0.05)
    assert not np.allclose(one.values, other.values, atol=0.01 * np.abs(whole.values).max())


def test_half_images_refuse_few_sensors_and_lines():
    grid = ImageGrid(8)
    for positions in (np.zeros((4, 2)), np.linspace(-1e-3, 1e-3, 20)):
        acquisition = Acquisition(
            np.zeros((len(positions), 32)), positions, dt=32e-9, sound_speed=1500.0, aperture=4e-3
        )
        with pytest.raises(InvalidInput, match="sensors"):
            half_images(acquisition, mask_outline(), grid)


def mask_outline():
    return survey_mask(4e-3, 20).outline


def test_morton_order_visits_each_quarter_at_one_go():
    places = np.random.default_rng(0).uniform(0, 1, (400, 2))
    places[:2] = (0, 0), (1, 1)
    order = morton_order(places)
    quarter = (places[order] >= 0.5) @ [1, 2]
    assert sorted(order) == list(range(400))
    assert (np.diff(quarter) != 0).sum() == 3
