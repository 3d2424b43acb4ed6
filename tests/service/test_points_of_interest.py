"""Points of interest in images: balls at known places, dots, streaks and noise."""

import multiprocessing
import pickle

import numpy as np
import pytest

from steradian.core.exceptions import InvalidInput
from steradian.imaging import Volume, VoxelAxes
from steradian.masks.staged import survey_mask
from steradian.phantoms import Balls, add_noise, pressure
from steradian.plans import ScanPlan
from steradian.plans.stages import FocusStage
from steradian.quality.points_of_interest import find_points_of_interest, mean_image
from steradian.reconstructions.stages.planner import propose
from steradian.reconstructions.stages.survey_image import find_in_scan, survey_image
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from support.alines import Aline

X = (np.arange(48) - 23.5) * 120e-6
Z = np.arange(60) * 80e-6
NOISE = 0.05


def as_volume(values, x=X, y=X):
    spacing = (120e-6, 80e-6) if y is None else (120e-6, 120e-6, 80e-6)
    return Volume(values.astype(np.float32), VoxelAxes(x, y, Z), spacing)


def volume(*balls, seed=0, noise=NOISE, width=200e-6):
    """Return an image of Gaussian balls (x, y, z, amplitude) in white noise."""
    values = np.random.default_rng(seed).normal(0, noise, (len(X), len(X), len(Z)))
    for x, y, z, amplitude in balls:
        across = (X[:, None, None] - x) ** 2 + (X[None, :, None] - y) ** 2 + (Z - z) ** 2
        values += amplitude * np.exp(-across / 2 / width**2)
    return as_volume(values)


def distance(found, place):
    return float(np.linalg.norm(np.subtract(found.position, place)))


@pytest.mark.parametrize("place", [(0.41e-3, -1.13e-3, 2.03e-3), (-1.5e-3, 0.9e-3, 3.57e-3)])
def test_ball_is_found_between_voxels(place):
    (found,) = find_points_of_interest(volume((*place, 1.0)))
    assert distance(found, place) < 25e-6
    assert found.amplitude == pytest.approx(1.0, abs=0.2)
    assert found.signal_to_noise > 50


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_found_in_noise(seed):
    assert find_points_of_interest(volume(seed=seed), choice="several", count=8) == []
    assert find_points_of_interest(volume(noise=0.0)) == []


def test_choice_decides_between_the_brightest_and_the_nearest():
    bright, near = (1.2e-3, 0.0, 3.6e-3), (-1.2e-3, 0.0, 1.6e-3)
    image = volume((*bright, 1.0), (*near, 0.6))
    assert distance(find_points_of_interest(image)[0], bright) < 50e-6
    assert distance(find_points_of_interest(image, choice="nearest")[0], near) < 50e-6
    both = find_points_of_interest(image, choice="several", count=4)
    assert [min(distance(found, bright), distance(found, near)) < 50e-6 for found in both] == [True, True]
    assert len(find_points_of_interest(image, choice="several", count=1)) == 1


def test_parts_of_one_object_are_one_point():
    image = volume((0.0, 0.0, 2e-3, 1.0), (0.5e-3, 0.3e-3, 2.2e-3, 0.9), (-0.4e-3, 0.2e-3, 1.8e-3, 0.8))
    (found,) = find_points_of_interest(image, choice="several", count=8)
    assert distance(found, (0.0, 0.1e-3, 2e-3)) < 0.3e-3


def test_weak_blob_beside_a_bright_one_is_left_out_as_its_side_lobe():
    image = volume((1.5e-3, 0.0, 2e-3, 1.0), (-1.5e-3, 0.0, 2e-3, 0.2), noise=0.01)
    assert len(find_points_of_interest(image, choice="several", count=8)) == 1


def test_depth_limits_the_search():
    image = volume((1.2e-3, 0.0, 3.6e-3, 1.0), (-1.2e-3, 0.0, 1.6e-3, 0.6))
    (found,) = find_points_of_interest(image, depth=(1e-3, 2.4e-3))
    assert found.position[2] == pytest.approx(1.6e-3, abs=50e-6)
    assert find_points_of_interest(image, depth=(4.6e-3, 4.7e-3)) == []


def dotted(image, seed, share=1.0):
    """Return the image with bright dots below a hundred sensors, nothing between them, in the first half millimetre."""
    random = np.random.default_rng(seed)
    values = image.values.copy()
    values[:, :, :6] *= 0.1
    for i, j in random.integers(0, len(X), (100, 2)):
        if random.random() < share:
            values[i, j, :6] += random.normal(0, 2, 6)
    return as_volume(values)


def test_near_field_is_left_out():
    place = (0.5e-3, 0.5e-3, 2.5e-3)
    image = dotted(volume((*place, 0.5)), 1)
    assert np.abs(image.values[:, :, :6]).max() > 5 * np.abs(image.values[:, :, 6:]).max()
    for choice in ("brightest", "nearest"):
        assert distance(find_points_of_interest(image, choice=choice)[0], place) < 100e-6


def test_halves_reject_a_blob_that_one_half_of_the_sensors_sees():
    place, ghost = (1.2e-3, 0.0, 2e-3), (-1.2e-3, 0.0, 3e-3)
    halves = (volume((*place, 0.5), (*ghost, 1.0), seed=1), volume((*place, 0.5), seed=2))
    image = mean_image(halves)
    assert (
        distance(find_points_of_interest(image)[0], place) < 100e-6
        or len(find_points_of_interest(image, choice="several", count=2)) == 2
    )
    (found,) = find_points_of_interest(image, choice="several", count=2, halves=halves)
    assert distance(found, place) < 60e-6


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"choice": "darkest"}, "choice"),
        ({"count": 0}, "count"),
        ({"count": 9}, "count"),
        ({"least_signal_to_noise": 0.0}, "least_signal_to_noise"),
        ({"depth": (2e-3, 1e-3)}, "depth"),
        ({"depth": (-1e-3, 1e-3)}, "depth"),
    ],
)
def test_search_refuses_and_names_the_field(options, field):
    with pytest.raises(InvalidInput) as error:
        find_points_of_interest(volume(), **options)
    assert error.value.field == field


def test_search_refuses_an_image_of_a_line_and_halves_of_other_voxels():
    image = volume()
    with pytest.raises(InvalidInput, match="volume"):
        find_points_of_interest(as_volume(image.values[:, 0], y=None))
    smaller = as_volume(image.values[:40], x=X[:40])
    with pytest.raises(InvalidInput, match=r"halves\.1"):
        find_points_of_interest(image, halves=(image, smaller))


APERTURE, BALL = 6e-3, (1.1e-3, -0.7e-3, 1.6e-3)


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    """A scan file of 60 points that saw a ball in noise."""
    path = tmp_path_factory.mktemp("survey") / "scan.h5"
    mask = survey_mask(APERTURE, 60)
    plan = ScanPlan.create(mask=mask, samples=384, sampling_interval=16e-9)
    ball = Balls(np.array([BALL]), np.array([120e-6]), np.array([1.0]))
    traces = pressure(ball, mask.positions, samples=384, sampling_interval=16e-9, sound_speed=plan.sound_speed)
    traces = add_noise(traces, 30.0, seed=1)
    scale = float(np.abs(traces).max()) / 30000
    counts = np.rint(traces[plan.visit] / scale).astype(np.int16)
    create_scan_file(path, plan, simulated=True)
    with ScanFileWriter(path) as store:
        store.append(Aline(n, line, scale=scale) for n, line in enumerate(counts))
    return path


def test_survey_proposes_the_ball_and_the_promise_of_a_focus(survey):
    (proposal,) = propose(survey, FocusStage(points=100))
    assert np.linalg.norm(np.subtract(proposal.position, BALL)) < 0.15e-3
    assert proposal.promise["contrast_db"] > 25
    assert proposal.promise["solid_angle_share"] == pytest.approx(0.5, abs=0.25)
    assert (find_in_scan(survey)[0].position, find_in_scan(survey)[0].signal_to_noise) == (
        proposal.position,
        proposal.signal_to_noise,
    )


def test_survey_image_has_coarse_voxels(survey):
    image = survey_image(survey)
    assert image.volume.spacing == pytest.approx((120e-6, 120e-6, 48e-6))
    np.testing.assert_allclose(image.volume.values, (image.halves[0].values + image.halves[1].values) / 2)


def test_proposals_can_be_sent_to_another_process(survey):
    proposals = find_in_scan(survey)
    assert pickle.loads(pickle.dumps(proposals)) == proposals  # noqa: S301 - our own
    assert pickle.loads(pickle.dumps(find_in_scan)) is find_in_scan  # noqa: S301


@pytest.mark.long
def test_another_process_proposes_the_same(survey):
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply(find_in_scan, (survey,)) == find_in_scan(survey)


def test_survey_of_too_few_points_is_refused(tmp_path):
    mask = survey_mask(APERTURE, 12)
    create_scan_file(tmp_path / "scan.h5", ScanPlan.create(mask=mask, samples=64), simulated=True)
    with ScanFileWriter(tmp_path / "scan.h5") as store:
        store.append(Aline(n, np.ones(64, np.int16)) for n in range(mask.count))
    with pytest.raises(InvalidInput, match="16 or more"):
        find_in_scan(tmp_path / "scan.h5")
