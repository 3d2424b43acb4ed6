"""Records of any length, and positions that were stored in float32."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from steradian.imaging import direct_spectrum, spectrum_of
from support.flat import flat_plan, flat_reconstruct

SIDE = 6e-3
STEP = 8e-9 * 1500.0
COMMON: dict[str, Any] = {"sampling_interval": 8e-9, "sound_speed": 1500.0, "aperture": SIDE}
RNG = np.random.default_rng(0)


@pytest.mark.long
@pytest.mark.parametrize("samples", [131, 179, 2 * 149])
def test_a_record_with_a_large_prime_is_the_direct_sums_of_one_a_little_longer(samples: int) -> None:
    positions, traces = (RNG.random((30, 2)) - 0.5) * SIDE, RNG.standard_normal((30, samples))
    record = flat_plan(positions, samples=samples, modes=12, **COMMON).geometry.record
    assert samples < record < 1.05 * samples
    whole = flat_reconstruct(
        traces, positions, modes=12, depth_range=(0, (record - 1) * STEP), tolerance=1e-6, **COMMON
    )
    j, l = RNG.integers(-6, 6, (200, 2)), RNG.integers(1, record // 2, 200)  # noqa: E741
    expected = direct_spectrum(traces, positions, j, l, modes=12, record=record, **COMMON)
    found = spectrum_of(whole.values, j, l)
    assert np.linalg.norm(found - expected) <= 1e-6 * np.linalg.norm(expected)
    image = flat_reconstruct(traces, positions, modes=12, tolerance=1e-6, **COMMON)
    np.testing.assert_allclose(image.axes.z, np.arange(samples) * STEP)
    np.testing.assert_allclose(image.values, whole.values[..., :samples], atol=1e-12)


@pytest.mark.parametrize("samples", [1021, 1011, 4093, 65_521])
def test_no_length_needs_a_slow_transform(samples: int) -> None:
    plan = flat_plan(np.zeros((1, 2)), samples=samples, modes=4, memory_limit=1 << 30, **COMMON)
    rest = plan.geometry.record
    assert samples <= rest < 1.02 * samples
    for prime in range(2, 128):
        while rest % prime == 0:
            rest //= prime
    assert rest == 1


@pytest.mark.parametrize("samples", [45, 100, 1017, 1024, 2 * 113])
def test_other_records_stay_as_they_are(samples: int) -> None:
    plan = flat_plan(np.zeros((1, 2)), samples=samples, modes=4, **COMMON)
    assert plan.geometry.record == samples


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6])
@pytest.mark.parametrize("displaced", [0.0, 0.3])
def test_a_grid_stored_in_float32_is_one(tolerance: float, displaced: float) -> None:
    count = 100
    axis = (np.arange(count) - count / 2 + displaced) * SIDE / count
    exact = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    traces = RNG.standard_normal((len(exact), 64))
    stored = exact.astype(np.float32)
    for positions in (stored, stored.astype(np.float64)):
        plan = flat_plan(positions, samples=64, modes=count, tolerance=tolerance, **COMMON)
        assert plan.method == "ner"
        image = plan.run(traces).values  # type: ignore[union-attr]
        expected = flat_reconstruct(traces, exact, modes=count, tolerance=tolerance, **COMMON).values
        assert np.linalg.norm(image - expected) <= 2 * tolerance * np.linalg.norm(expected)


def test_sensors_beside_a_grid_by_more_than_rounding_are_not_on_it() -> None:
    axis = (np.arange(20) - 10) * SIDE / 20
    exact = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    jitter = exact + 1e-7 * RNG.standard_normal(exact.shape)  # a thousandth of a cell
    assert flat_plan(jitter.astype(np.float32), samples=64, modes=20, **COMMON, wrap=True).method == "nedner"


def test_an_aperture_that_ends_at_sensors_rounded_to_float32_is_accepted() -> None:
    edge = np.array([[-0.003, -0.003], [0.003, 0.003], [0.0013, -0.003]], np.float32)
    assert 2 * float(edge.max()) > SIDE
    flat_reconstruct(np.ones((3, 64)), edge, modes=8, **COMMON)
