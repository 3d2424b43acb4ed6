"""Shift of an object between two volumes: by formula, and through simulated scans with noise."""

import numpy as np
import pytest

from steradian import Acquisition, ImageGrid, InvalidInput, Volume, equi_steradian_mask, reconstruct
from steradian.imaging import VoxelAxes
from steradian.phantoms import Balls, add_noise, pressure
from steradian.quality.registration import estimate_shift
from steradian.reconstructions.series.frames import SeriesFrame
from steradian.reconstructions.series.series import Series

STEP = (100e-6, 100e-6, 50e-6)
AXES = VoxelAxes(*(step * np.arange(40) for step in STEP))
RANDOM = np.random.default_rng(0)
CENTRES = RANDOM.uniform(0.3, 0.7, (12, 3)) * 39 * np.array(STEP)


def volume(shift=(0.0, 0.0, 0.0), brightness=1.0, noise=0.0, seed=0):
    """Gaussian balls, moved by a shift in m, in white noise."""
    places = (AXES.x[:, None, None], AXES.y[:, None], AXES.z)
    values = sum(
        np.exp(-sum((place - c) ** 2 for place, c in zip(places, centre, strict=True)) / (2 * 150e-6**2))
        for centre in CENTRES + np.array(shift)
    )
    random = np.random.default_rng(seed)
    return Volume((brightness * values + noise * random.standard_normal(values.shape)).astype(np.float32), AXES, STEP)


@pytest.mark.parametrize("shift", [(130e-6, 0.0, 0.0), (0.0, -220e-6, 0.0), (0.0, 0.0, 33e-6), (40e-6, 15e-6, -70e-6)])
def test_shift_of_another_brightness_in_noise_is_found_within_its_error(shift):
    found = estimate_shift(volume(noise=0.02), volume(shift, brightness=0.6, noise=0.02, seed=1))
    deviation = np.abs(np.array(found.metres) - shift)
    assert (deviation <= 3 * np.array(found.standard_error) + 0.1e-6).all()
    assert max(found.standard_error) < 3e-6
    assert found.is_significant


def test_object_that_stays_has_no_significant_shift_and_is_left():
    series = Series([SeriesFrame((n,)) for n in range(2)], lambda n: volume(noise=0.02, seed=n))
    still, shifts = series.aligned()
    assert not shifts[1].is_significant
    np.testing.assert_array_equal(still[1].values, series[1].values)


def test_alignment_moves_the_object_back():
    series = Series([SeriesFrame((n,)) for n in range(2)], lambda n: volume(shift=(n * 130e-6, 0.0, n * -60e-6)))
    still, _ = series.aligned()
    assert np.abs(still[1].values - series[0].values).max() < 0.02 * series[0].values.max()


def test_volumes_that_differ_in_voxels_or_are_empty_are_refused():
    other = Volume(volume().values[:20], VoxelAxes(AXES.x[:20], AXES.y, AXES.z), STEP)
    with pytest.raises(InvalidInput, match="moved is a volume of shape"):
        estimate_shift(volume(), other)
    with pytest.raises(InvalidInput, match="volumes is all zero"):
        estimate_shift(volume(), Volume(np.zeros((40, 40, 40), np.float32), AXES, STEP))


@pytest.mark.long
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_300_micrometres_between_scans_at_30_db_are_found_within_10(axis):
    mask = equi_steradian_mask(13.56e-3, 3.6e-3, 1600)
    centres = np.column_stack([RANDOM.uniform(-2e-3, 2e-3, (30, 2)), RANDOM.uniform(1.5e-3, 4e-3, 30)])
    shift = 300e-6 * np.eye(3)[axis]
    images = []
    for seed, places in enumerate((centres, centres + shift)):
        balls = Balls(places, np.full(30, 70e-6), np.ones(30))
        traces = pressure(balls, mask.positions, samples=300, sampling_interval=16e-9, sound_speed=1500.0)
        acquisition = Acquisition(add_noise(traces, 30.0, seed=seed), mask, dt=16e-9, sound_speed=1500.0)
        images.append(reconstruct(acquisition, ImageGrid(128, depth=(1e-3, 5e-3))))
    np.testing.assert_allclose(estimate_shift(*images).metres, shift, atol=10e-6)
