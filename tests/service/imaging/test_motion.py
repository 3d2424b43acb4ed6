"""Motion of the object within a scan, known to the simulation alone: found, undone, and left where there is none."""

import numpy as np
import pytest

from steradian import Acquisition, ImageGrid, InvalidInput, Layer, Medium, equi_steradian_mask, reconstruct
from steradian.core.exceptions import Cancelled
from steradian.imaging.motion import Motion, estimate_motion, reconstruct_moving
from steradian.quality import estimate_shift, tenenbaum

MASK = equi_steradian_mask(8e-3, 2.6e-3, 900)
INTERVAL, SAMPLES, SPEED, SIZE = 20e-9, 200, 1500.0, 80e-6
GRID = ImageGrid(64, depth=(0.8e-3, 3.6e-3))
RANDOM = np.random.default_rng(0)
CENTRES = np.column_stack([RANDOM.uniform(-1.2e-3, 1.2e-3, (25, 2)), RANDOM.uniform(1.3e-3, 3e-3, 25)])
TIMES = RANDOM.permutation(MASK.count) / 50.0
"""Shots at 50 Hz in an order that does not follow the places."""


def scan(shifts, seed):
    """Return A-lines of Gaussian balls in closed form, each with the object where it is at its time; 30 dB."""
    time, lines = np.arange(SAMPLES) * INTERVAL, 0.0
    for centre in CENTRES:
        aside = MASK.positions - (centre[:2] + shifts[:, :2])
        distance = np.sqrt((aside**2).sum(axis=1) + (centre[2] + shifts[:, 2]) ** 2)[:, None]
        late = distance - SPEED * time
        lines = lines + late * np.exp(-(late**2) / (2 * SIZE**2)) / (2 * distance)
    noise = np.abs(lines).max() * 10**-1.5 * np.random.default_rng(seed).standard_normal(lines.shape)
    return Acquisition((lines + noise).astype(np.float32), MASK, dt=INTERVAL, sound_speed=SPEED)


def sharpness(volume):
    return tenenbaum(np.maximum(volume.mip("z"), 0))


@pytest.mark.parametrize(
    "amplitude",
    [
        pytest.param((0.0, 0.0, 100e-6), marks=pytest.mark.nightly),
        pytest.param((70e-6, -50e-6, 50e-6), marks=pytest.mark.long),
    ],
)
def test_breathing_of_100_micrometres_is_undone_to_95_per_cent_of_the_still_sharpness(amplitude):
    shifts = np.maximum(0, np.sin(2 * np.pi * TIMES / 4))[:, None] ** 2 * np.array(amplitude)
    still = sharpness(reconstruct(scan(np.zeros((MASK.count, 3)), 0), GRID))
    moving = scan(shifts, 1)
    motion = estimate_motion(moving, TIMES, GRID)
    assert motion.is_significant
    deviation = motion.at(TIMES) - (shifts - shifts.mean(axis=0))
    assert np.sqrt(np.mean(deviation**2, axis=0)).max() < 10e-6
    assert sharpness(reconstruct(moving, GRID)) < 0.9 * still
    assert sharpness(reconstruct_moving(moving, TIMES, motion, GRID)) >= 0.95 * still


@pytest.mark.nightly
def test_still_object_has_no_significant_motion():
    motion = estimate_motion(scan(np.zeros((MASK.count, 3)), 2), TIMES, GRID)
    assert not motion.is_significant


def test_shifts_are_linear_between_knots_and_significant_beyond_twice_their_error():
    knots, error = np.array([0.0, 1.0, 2.0]), np.full((3, 3), 5e-6)
    motion = Motion(knots, np.array([[0, 0, 0], [40e-6, 0, 0], [0, 0, 0]]), error)
    np.testing.assert_allclose(motion.at([0.25, 1.5, 3.0])[:, 0], [10e-6, 20e-6, 0])
    assert motion.is_significant
    assert not Motion(knots, 0.2 * motion.shifts, error).is_significant


def test_known_shift_of_all_shots_is_undone():
    shifts = np.broadcast_to([100e-6, 0.0, 60e-6], (MASK.count, 3))
    motion = Motion(np.array([0.0, 20.0]), np.array(shifts[:2]), np.zeros((2, 3)))
    moved = reconstruct_moving(scan(shifts, 0), TIMES, motion, GRID)
    still = reconstruct(scan(0 * shifts, 0), GRID)
    np.testing.assert_allclose(estimate_shift(still, moved).metres, 0, atol=8e-6)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"times": np.zeros(MASK.count)}, "times is shape"),
        ({"times": TIMES[:7]}, "times"),
        ({"acquisition": Acquisition(np.ones((MASK.count, 50)), MASK, dt=1e-8, sound_speed=1500.0,
                                     sensitivity=np.ones(MASK.count))}, "sensitivity is an array"),
        ({"reach": 1.0}, "reach is 1.0; allowed: 2e-05 to 0.001 m"),
        ({"interval": -1.0}, "interval is -1.0; allowed: above 0 s"),
        ({"acquisition": Acquisition(np.ones((9, 50)), np.linspace(-1e-3, 1e-3, 9), dt=1e-8, sound_speed=1500.0,
                                     aperture=3e-3), "times": np.arange(9)}, "sensors is 9 on a line"),
        ({"acquisition": Acquisition(np.ones((MASK.count, 50)), MASK, dt=1e-8,
                                     medium=Medium([Layer(1480.0, 1e-3), Layer(1500.0)]))}, "one layer"),
    ],
)  # fmt: skip
def test_wrong_values_are_refused_with_field_and_range(change, told):
    given = {"acquisition": Acquisition(np.ones((MASK.count, 50), np.float32), MASK, dt=INTERVAL, sound_speed=SPEED)}
    with pytest.raises(InvalidInput, match=told):
        estimate_motion(**(given | {"times": TIMES, "grid": ImageGrid(16)} | change))


def test_estimation_can_be_cancelled():
    with pytest.raises(Cancelled):
        estimate_motion(scan(np.zeros((MASK.count, 3)), 0), TIMES, ImageGrid(16, depth=(1e-3, 2e-3)),
                        rounds=1, cancelled=lambda: True)  # fmt: skip
