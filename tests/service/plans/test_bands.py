"""Bands of wavelength: how much is lost, how few there are, and how much time that saves."""

import numpy as np
import pytest

from steradian import InvalidInput, ScanPlan, equi_steradian_mask, grid_mask
from steradian.plans import Fringe, Link, Tuning, VisitOrder, preview
from steradian.plans.files import read_json, write_json
from steradian.plans.wavelength_bands import hold_wavelength, partition_bands
from steradian_benchmarks.visit_orders import optimal_wavelengths, simulated_seconds

MASK = equi_steradian_mask(13.56e-3, 3.6e-3, 1600)
SLOW = Tuning(settling=5e-3, speed=1.0)
EACH = Tuning(settling=5e-3, speed=1.0, tolerance=0.0)
FREE = Link(byte_rate=None)


def reflected(offset, fringe):
    """Return the level a film reflects, from the textbook: a Lorentzian dip, or Airy's of the same width."""
    if fringe.free_spectral_range is None:
        return 1 - 1 / (1 + (2 * offset / fringe.linewidth) ** 2)
    phase, half = (np.pi * each / fringe.free_spectral_range for each in (offset, fringe.linewidth / 2))
    return 1 - 1 / (1 + (np.sin(phase) / np.sin(half)) ** 2)


@pytest.mark.parametrize("flank", ["above", "below"])
@pytest.mark.parametrize("free", [None, 3e-9, 1.1e-9])
def test_sensitivity_loss_matches_fringe_slope_ratio(free, flank):
    """Slopes by differences of the reflected level, the steepest by search on a fine grid."""
    fringe = Fringe(linewidth=400e-12, free_spectral_range=free, flank=flank)
    side = 1 if flank == "above" else -1
    offset = side * np.linspace(0, 500e-12, 500_001)
    slope = side * np.gradient(reflected(offset, fringe), offset)
    best = offset[np.argmax(slope)]
    for detuning in (-60e-12, -10e-12, 0.0, 25e-12, 80e-12):
        expected = 1 - np.interp(side * (best + detuning), side * offset, slope) / slope.max()
        assert float(fringe.sensitivity_loss(np.array(detuning))) == pytest.approx(expected, abs=2e-5)
    low, high = fringe.wavelength_tolerance(0.2)
    np.testing.assert_allclose(fringe.sensitivity_loss(np.array([-low, high])), 0.2, atol=1e-6)


def test_an_uncertain_optimum_loses_its_mean_over_the_uncertainty():
    """Beside the mean over a million draws."""
    fringe = Fringe()
    drawn = np.random.default_rng(0).normal(20e-12, 40e-12, 1_000_000)
    expected = fringe.expected_loss(np.array([20e-12]), 40e-12)
    assert expected == pytest.approx(fringe.sensitivity_loss(drawn).mean(), rel=5e-3)


@pytest.mark.parametrize("seed", range(6))
def test_there_are_as_few_bands_as_there_can_be_and_no_point_loses_more(seed):
    """The fewest intervals that cover points on a line are found by beginning each at the first one left."""
    random = np.random.default_rng(seed)
    values = 1.55e-6 + random.choice([random.uniform(0, 4e-9, 700), random.normal(0, 5e-10, 700)][seed % 2], 700)
    fringe, loss = Fringe(), (0.02, 0.1, 0.5)[seed % 3]
    reach = fringe.wavelength_tolerance(loss)
    fewest, end = 0, -np.inf
    for value in np.sort(values):
        if value > end:
            fewest, end = fewest + 1, value + sum(reach)
    bias = partition_bands(values, reach, fringe)
    # optima are put into cells of a 64th of a band, so a band may have to be that much narrower
    assert fewest <= len(np.unique(bias)) <= np.ceil(fewest * 64 / 63)
    assert fringe.sensitivity_loss(bias - values).max() <= loss


def test_partition_bands_minimizes_loss_for_fewest_bands():
    """Three heaps that two bands could cover, but only one cut leaves the two close ones together."""
    heaps = 1.55e-6 + 1e-12 * np.repeat([0.0, 60.0, 140.0], 50)
    bias = partition_bands(heaps, (60e-12, 60e-12), Fringe())
    assert len(np.unique(bias)) == 2
    assert bias[0] == bias[50] != bias[100]


def test_hold_wavelength_changes_only_outside_tolerance():
    """Never beyond, and changed only when it must be."""
    values = np.cumsum(np.random.default_rng(3).normal(0, 3e-12, 500)) + 1.55e-6
    bias = hold_wavelength(values, (20e-12, 30e-12))
    away = bias - values
    assert away.min() >= -20e-12
    assert away.max() <= 30e-12
    for before, after, value in zip(bias[:-1], bias[1:], values[1:], strict=True):
        assert after == before or not -20e-12 <= before - value <= 30e-12


def planned(order, film="scatter", loss=0.0, rate=1000.0, tuning=SLOW, mask=MASK):
    """Return a plan over a simulated film."""
    return ScanPlan.create(
        mask=mask,
        order=order,
        wavelengths=optimal_wavelengths(mask, film),
        max_sensitivity_loss=loss,
        pulse_rate=rate,
        tuning=tuning,
        link=FREE,
    )


def test_a_film_that_scatters_is_measured_five_times_faster_for_a_tenth_of_its_sensitivity():
    """1 kHz and 5 ms a retuning, beside a snake that is tuned anew at every point."""
    snake, bands = planned("snake", tuning=EACH), planned("bands", loss=0.1)
    cost = preview(bands)
    assert sorted(bands.visit.tolist()) == list(range(MASK.count))
    assert cost.sensitivity_loss["max"] <= 0.1
    assert cost.sensitivity_loss["mean"] < 0.05
    assert cost.retunings == cost.bands - 1 < 40
    assert preview(snake).total_seconds / cost.total_seconds >= 5


@pytest.mark.long
def test_simulated_scan_time_matches_preview():
    """By its own clock, to half a per cent."""
    for plan in (planned("snake", tuning=EACH), planned("bands", loss=0.1)):
        assert simulated_seconds(plan, "scatter") == pytest.approx(preview(plan).total_seconds, rel=5e-3)


@pytest.mark.parametrize("film", ["wedge", "domains", "both"])
def test_bands_are_never_slower_than_other_orders(film):
    """On films that vary smoothly or in patches, too."""
    seconds = {
        order: preview(planned(order, film, 0.05)).total_seconds
        for order in ("bands", "snake", "wavelength", "hilbert")
    }
    assert seconds["bands"] == min(seconds.values())


def test_every_point_has_its_own_wavelength_where_that_costs_nothing():
    """At 50 Hz the pulse period hides the retuning."""
    cost = preview(planned("bands", loss=0.1, rate=50.0))
    assert cost.limiting == "laser"
    assert cost.total_seconds == pytest.approx(MASK.count / 50)
    assert cost.sensitivity_loss["max"] < 0.005


@pytest.mark.parametrize("order", ["bands", "snake", "wavelength"])
def test_no_point_loses_more_than_is_allowed_however_tolerant_the_laser_is(order):
    """10 pm beside the best wavelength lose 0.3 %; a plan that allows less has to be retuned for them."""
    mask = grid_mask(1e-2, 12, 8e-4)
    wavelengths = 1.55e-6 + np.random.default_rng(0).normal(0, 20e-12, mask.count)
    for tolerance in (10e-12, 1e-9):
        plan = ScanPlan.create(
            mask=mask,
            order=order,
            wavelengths=wavelengths,
            max_sensitivity_loss=1e-3,
            pulse_rate=1000.0,
            tuning=Tuning(settling=5e-3, tolerance=tolerance),
        )
        assert 0 < preview(plan).sensitivity_loss["max"] <= 1e-3


@pytest.mark.long
def test_50_000_points_are_put_into_bands():
    """Nothing grows with the square of their number."""
    mask = equi_steradian_mask(13.56e-3, 3.6e-3, 50_000)
    wavelengths = 1.55e-6 + np.random.default_rng(0).uniform(-2e-9, 2e-9, mask.count)
    plan = ScanPlan.create(
        mask=mask, order="bands", wavelengths=wavelengths, max_sensitivity_loss=0.1, pulse_rate=1000, tuning=SLOW
    )
    assert np.bincount(plan.visit, minlength=mask.count).tolist() == [1] * mask.count
    assert preview(plan).retunings < 40


def test_banded_plan_round_trips_and_unbanded_plan_id_is_unchanged(tmp_path):
    """The file holds what was asked for, and names of plans made before there were bands stay."""
    plan = planned("bands", loss=0.1, mask=grid_mask(1e-2, 8, 1e-3))
    write_json(plan, tmp_path / "plan.json")
    again = read_json(ScanPlan, tmp_path / "plan.json")
    assert again.id == plan.id
    np.testing.assert_array_equal(again.bias, plan.bias)
    old = ScanPlan.create(mask=grid_mask(1e-2, 8, 1e-3), wavelengths=np.linspace(1.549e-6, 1.551e-6, 64))
    assert old.id == "p236bb14399ba93f28785c1dc"
    assert old.replace(max_sensitivity_loss=0.1).id != old.id


def test_bands_need_wavelengths_and_a_loss_in_its_range():
    """Refused with the field's name."""
    with pytest.raises(InvalidInput, match="order"):
        ScanPlan.create(mask=MASK, order=VisitOrder.BANDS)
    with pytest.raises(InvalidInput, match="max_sensitivity_loss"):
        ScanPlan.create(mask=MASK, max_sensitivity_loss=1.0)
    with pytest.raises(InvalidInput, match="free_spectral_range"):
        Fringe.create(linewidth=5e-10, free_spectral_range=9e-10)
