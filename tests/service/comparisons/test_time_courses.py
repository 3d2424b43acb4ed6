"""Time courses: steps and exponentials of known parameters, temporal signal-to-noise ratio by NumPy."""

import numpy as np
import pytest

from steradian import InvalidInput, Volume
from steradian.imaging import VoxelAxes
from steradian.quality import fit_time_course, summarise_courses, temporal_snr

TIMES = np.arange(40.0)


def within_one_error(model, clean, truth, noise, repeats=120):
    """Share of repeats in which each true parameter lies within one standard error."""
    random = np.random.default_rng(3)
    found = [fit_time_course(TIMES, clean + noise * random.standard_normal(40), model) for _ in range(repeats)]
    return {
        name: np.mean([abs(getattr(each, name) - value) <= getattr(each, f"{name}_error") for each in found])
        for name, value in truth.items()
    }


def test_step_without_noise_is_found_to_the_interval():
    found = fit_time_course(TIMES, 2.0 + 3.0 * (TIMES > 17.2))
    assert (found.baseline, found.amplitude, found.time) == pytest.approx((2.0, 3.0, 17.5))
    assert found.time_error == pytest.approx(1 / np.sqrt(12))
    assert found.time_constant is None
    assert found.residual == pytest.approx(0.0, abs=1e-6)


def test_step_in_noise_has_errors_that_hold_68_per_cent_of_truths():
    shares = within_one_error("step", 1.0 + 0.5 * (TIMES > 14.5), {"baseline": 1.0, "amplitude": 0.5}, 0.3)
    assert all(0.58 < share < 0.78 for share in shares.values()), shares


def test_exponential_without_noise_has_its_parameters():
    clean = 1.0 - 0.4 * np.expm1(-np.maximum(TIMES - 9.3, 0) / 6.0)
    found = fit_time_course(TIMES, clean, "exponential")
    assert (found.baseline, found.amplitude, found.time, found.time_constant) == pytest.approx((1.0, 0.4, 9.3, 6.0))


@pytest.mark.long
def test_exponential_in_noise_has_errors_that_hold_68_per_cent_of_truths():
    clean = 1.0 - 0.4 * np.expm1(-np.maximum(TIMES - 9.3, 0) / 6.0)
    truth = {"baseline": 1.0, "amplitude": 0.4, "time": 9.3, "time_constant": 6.0}
    shares = list(within_one_error("exponential", clean, truth, 0.02).values())
    assert 0.62 < np.mean(shares) < 0.74, shares
    assert min(shares) > 0.55


def test_unfit_courses_are_refused_with_field_and_range():
    for times, values, model, told in (
        (TIMES[:4], TIMES[:4], "step", "at least 5 times"),
        (TIMES[:5], TIMES[:5], "exponential", "at least 6 times"),
        (TIMES[::-1], TIMES, "step", "times is not rising"),
        (TIMES, np.ones(40), "step", "finite values that change"),
        (TIMES, TIMES, "ramp", "model is ramp; allowed: step, exponential"),
    ):
        with pytest.raises(InvalidInput, match=told):
            fit_time_course(times, values, model)


def test_temporal_snr_is_numpys_mean_over_deviation():
    values = np.random.default_rng(0).normal(5.0, 1.0, (6, 4, 3, 5)).astype(np.float32)
    values[:, 0, 0, 0] = 1.0
    axes = VoxelAxes(np.arange(4.0), np.arange(3.0), np.arange(5.0))
    found = temporal_snr(Volume(each, axes, (1.0,) * 3) for each in values)
    deviation = values.std(axis=0, ddof=1, dtype=float).ravel()[1:]
    np.testing.assert_allclose(found.values.ravel()[1:], values.mean(axis=0).ravel()[1:] / deviation, rtol=1e-5)
    assert np.isnan(found.values[0, 0, 0])
    with pytest.raises(InvalidInput, match="volumes is 2; allowed: at least 3"):
        temporal_snr([Volume(each, axes, (1.0,) * 3) for each in values[:2]])


def test_courses_are_by_region_and_wavelength():
    rows = [
        {"name": name, "excitation": light, "time": float(n), "mean": n + light * 1e7}
        for n in range(6)
        for light in (7e-7, 8e-7)
        for name in ("a", "b")
    ]
    found = summarise_courses(rows)
    assert [(row["name"], row["excitation"]) for row in found] == [(n, w) for w in (7e-7, 8e-7) for n in "ab"]
    assert found[0]["mean"] == pytest.approx(9.5)
    assert found[0]["temporal_snr"] == pytest.approx(9.5 / np.std(np.arange(6), ddof=1))
    assert summarise_courses(rows, "step")[0]["amplitude"] > 0
    unknown = [row | {"time": None} for row in rows]
    with pytest.raises(InvalidInput, match="times is not known"):
        summarise_courses(unknown, "step")
