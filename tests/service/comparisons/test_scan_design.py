"""Points × averages for a number of pulses: the prediction beside scans simulated and reconstructed independently."""

import json

import numpy as np
import pytest

import steradian
from steradian.comparisons.design_result import PulseSplit, choose
from steradian.comparisons.pulse_split import Budget, split_pulses
from steradian.comparisons.vessel_image import ExpectedReading, VesselImage
from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.masks import grid_mask
from steradian.phantoms.forward import pressure
from steradian.phantoms.spheres_and_cylinders import cylinder, gaussian_cylinder
from steradian.phantoms.vessel_alines import vessel_alines
from steradian.quality.pulse_noise import PulseNoise, measure_pulse_noise
from steradian_benchmarks import budget

VESSEL = {"depth": 1.5e-3, "vessel": 150e-6, "aperture": 5e-3}


def split(points, contrast, scatter=0.01, width=180e-6):
    """A split with given figures; of the plan only the number of points counts."""
    plan = steradian.ScanPlan.create(mask=grid_mask(5e-3, points, 5e-3 / points))
    return PulseSplit("grid", "direct", plan, 1.0, ExpectedReading(contrast, width, scatter, 40.0, 70e-6))


def test_proposal_is_the_fewest_points_within_one_decibel_whose_width_is_known():
    splits = [
        split(2, 29.5, scatter=0.2),  # width not known
        split(3, 29.6, width=250e-6),  # another width than with many points
        split(4, 28.5),  # contrast too low
        split(5, 29.4),
        split(6, 30.0),
    ]
    assert choose(splits) is splits[3]
    assert choose([split(2, 10.0, scatter=0.5), split(3, 12.0, scatter=0.4)]).points == 9  # none is known: contrast
    assert choose([]) is None


def test_pulses_of_a_split_fit_into_the_time_and_few_are_left_over():
    made = Budget.create(
        time=60.0, pulses=None, pulse_rate=50.0, offset=(0.0, 0.0), max_points=20_000, sampling_interval=8e-9,
        sound_speed=1500.0, **VESSEL,
    )  # fmt: skip
    found = split_pulses(made, "equi-steradian", made.ladder())
    counts = [plan.mask.count for plan, _ in found]
    assert counts == sorted(set(counts))
    assert counts[-1] > 2_700
    for plan, seconds in found:
        assert plan.mask.count * plan.averages <= 3_000
        assert 0.9 * 60 < seconds <= 60 + 1e-6


def test_a_fast_laser_gives_fewer_points_because_the_beam_moves():
    slow, fast = (
        Budget.create(
            time=None, pulses=4_000, pulse_rate=rate, offset=(0.0, 0.0), max_points=20_000, sampling_interval=8e-9,
            sound_speed=1500.0, **VESSEL,
        )
        for rate in (50.0, 5_000.0)
    )  # fmt: skip
    counts = [split_pulses(each, "grid", (1,))[0][0].mask.count for each in (slow, fast)]
    assert counts[0] > 3_800
    assert counts[1] < 0.5 * counts[0]


def test_noise_of_one_pulse_is_measured_in_averaged_alines_of_known_noise():
    sensors = grid_mask(5e-3, 14, 350e-6, centred=True).positions
    balls = gaussian_cylinder(150e-6, (0.0, 0.0, 1.5e-3), (0.0, 1.0, 0.0), 2e-3, 12e-6)
    traces = pressure(balls, sensors, samples=512, sampling_interval=8e-9, sound_speed=1500.0)
    sigma = float(np.abs(traces).max()) / 10  # of one pulse: 20 dB
    noisy = traces + sigma / 4 * np.random.default_rng(1).standard_normal(traces.shape)
    found = measure_pulse_noise(noisy, averages=16)
    assert found.decibels == pytest.approx(20.0, abs=0.5)
    assert found.spectrum == pytest.approx(np.ones(16), abs=0.15)
    steps = np.round(noisy * 10_000).astype(np.int16)  # digitiser codes with a gain an A-line
    assert measure_pulse_noise(steps, 16, np.full(len(steps), 1e-4)).decibels == pytest.approx(found.decibels, abs=0.1)
    with pytest.raises(InvalidInput, match="times the noise"):
        measure_pulse_noise(np.random.default_rng(1).standard_normal((50, 512)))


def test_drawn_noise_has_the_measured_spectrum():
    spectrum = np.concatenate([np.full(8, 2.0), np.zeros(8)])
    drawn = PulseNoise(0.0, spectrum).draw((200, 512), 3)
    assert drawn.std() == pytest.approx(1.0, abs=0.05)
    power = (np.abs(np.fft.rfft(drawn, axis=1)) ** 2).mean(axis=0)
    assert power[160:].mean() < 0.02 * power[:100].mean()


def test_alines_of_a_vessel_are_those_of_the_sum_of_its_balls():
    sensors = grid_mask(5e-3, 8, 600e-6, centred=True).positions
    timing = {"samples": 400, "sampling_interval": 8e-9, "sound_speed": 1500.0}
    place = (1e-4, 0.0, 1.5e-3)
    summed = pressure(cylinder(150e-6, place, (0.0, 1.0, 0.0), 1e-3, 12e-6), sensors, **timing)
    fast = vessel_alines(150e-6, place, 1e-3, sensors, **timing)
    assert np.linalg.norm(fast - summed) < 0.08 * np.linalg.norm(summed)
    assert np.abs(fast).max() == pytest.approx(np.abs(summed).max(), rel=0.03)


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"time": None}, "pulses"),
        ({"pulses": 100}, "pulses"),
        ({"time": 0.1}, "time"),
        ({"vessel": 4e-3}, "vessel"),
        ({"depth": 1.0}, "depth"),
        ({"noise": 500.0}, "noise"),
        ({"arrangements": ("spiral",)}, "arrangements"),
        ({"methods": ()}, "methods"),
        ({"averages": [3_000]}, "averages"),
        ({"max_points": 3}, "max_points"),
    ],
)
def test_bad_input_names_its_field(wrong, field):
    given = {"noise": 20.0, "time": 60.0, **VESSEL} | wrong
    with pytest.raises(InvalidInput) as refused:
        steradian.design_scan(**given)
    assert refused.value.field == field


def test_a_design_can_be_stopped():
    with pytest.raises(Cancelled):
        steradian.design_scan(noise=20.0, time=60.0, cancelled=lambda: True, **VESSEL)


@pytest.mark.long
def test_more_points_lower_the_side_lobes_and_more_pulses_the_noise(tmp_path):
    """The contrast of a direct image grows with the pulses up to the side lobes' limit, which the points decide."""
    chosen = {"arrangements": ("grid",), "methods": ("direct",), "noise": 15.0, **VESSEL}
    few, many = (steradian.design_scan(pulses=200 * each, averages=[each // 8, each], **chosen) for each in (10, 100))
    for design in (few, many):
        limits = [each.expected.side_lobes_db for each in design.splits]
        assert limits[-1] > limits[0] + 6
        assert all(each.expected.contrast_db < each.expected.side_lobes_db + 0.5 for each in design.splits)
    assert many.chosen.expected.contrast_db > few.chosen.expected.contrast_db + 4
    dense = many.splits[-1].expected
    assert 150e-6 < dense.width < 220e-6
    assert dense.resolution < dense.width
    many.save(tmp_path / "design.png")
    assert (tmp_path / "design.png").stat().st_size > 10_000
    assert json.loads(json.dumps(many.as_json()))["chosen"]["points"] == many.chosen.points


@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(4, marks=pytest.mark.nightly),
        pytest.param(10, marks=pytest.mark.long),
        pytest.param(12, marks=pytest.mark.nightly),
    ],
)
def test_predicted_contrast_and_width_are_those_of_a_simulated_scan(seed):
    """Within 2 dB and 10 %, for vessels of other length, place and direction, with other noise."""
    (row,) = budget.compare(budget.Case.random(seed), ("direct",))
    assert row["usable"]
    decibels, share = budget.differences(row)
    assert abs(decibels) < 2
    assert abs(share) < 0.1


@pytest.mark.long
def test_iterative_images_have_empty_surroundings():
    mask = steradian.grid_mask(5e-3, 24, 5e-3 / 24, centred=True)
    image = VesselImage(mask, (0.0, 0.0, 1.5e-3), 150e-6, PulseNoise(25.0), 4, modes=84)
    found = image.expect("iterative")
    assert found.contrast_db == pytest.approx(40.0)
    assert found.width == pytest.approx(150e-6, rel=0.25)
    assert np.isnan(found.side_lobes_db)
