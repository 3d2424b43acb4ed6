"""The chain before and after the reconstruction does what its fields say, and nothing by default."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from steradian.core.exceptions import InvalidInput
from steradian.imaging import Conditioning, Display, Volume, VoxelAxes, rim_weights

DT = 1e-8
T = np.arange(400) * DT
RNG = np.random.default_rng(0)


def tone(frequency: float) -> np.ndarray:
    return np.sin(2 * np.pi * frequency * T) * np.exp(-(((T - 2e-6) / 0.5e-6) ** 2))


def test_nothing_is_changed_by_default() -> None:
    traces = RNG.standard_normal((5, 400)).astype(np.float32)
    np.testing.assert_array_equal(Conditioning().apply(traces, sampling_interval=DT), traces)


def test_first_samples_offset_and_common_signal_go() -> None:
    own = RNG.standard_normal((41, 400))
    common = 30 * tone(3e6)
    traces = own + common + 12
    traces[:, :50] += 1000
    before = traces.copy()
    chain = Conditioning(zero_first=50, remove_offset=True, remove_common="median")
    clean = chain.apply(traces, sampling_interval=DT)
    np.testing.assert_array_equal(traces, before)
    assert np.all(clean[:, :50] == 0)
    left = clean[:, 50:] - (own[:, 50:] - own[:, 50:].mean(axis=1, keepdims=True))
    assert np.sqrt(np.mean(left**2)) < 0.3
    mean = Conditioning(remove_common="mean").apply(traces, sampling_interval=DT)
    assert np.abs(mean.mean(axis=0)).max() < 1e-3


def test_offset_is_that_of_the_samples_that_are_not_zeroed() -> None:
    clean = Conditioning(zero_first=100, remove_offset=True).apply(np.full((2, 400), 12.0), sampling_interval=DT)
    np.testing.assert_allclose(clean, 0, atol=1e-6)


def test_the_band_passes_inside_and_stops_outside_without_a_delay() -> None:
    chain = Conditioning(band=(2e6, 10e6))
    inside, below, above = chain.apply(np.stack([tone(5e6), tone(0.4e6), tone(25e6)]), sampling_interval=DT)
    np.testing.assert_allclose(inside, tone(5e6), atol=0.01)
    assert np.abs(below).max() < 0.03
    assert np.abs(above).max() < 0.01
    low_pass = Conditioning(band=(None, 10e6)).apply(tone(0.4e6)[None], sampling_interval=DT)
    np.testing.assert_allclose(low_pass[0], tone(0.4e6), atol=0.01)


def test_a_response_of_ones_own_may_turn_the_phase() -> None:
    quarter = Conditioning(response=([0.0, 50e6], [1j, 1j])).apply(tone(5e6)[None], sampling_interval=DT)[0]
    expected = np.cos(2 * np.pi * 5e6 * T) * np.exp(-(((T - 2e-6) / 0.5e-6) ** 2))
    np.testing.assert_allclose(quarter, expected, atol=0.01)


def test_the_rim_fades_to_zero_at_the_sides_only() -> None:
    positions = np.array([[0.0, 0.0], [4e-3, 0.0], [4.5e-3, 0.0], [5e-3, 0.0], [4.5e-3, -4.5e-3]])
    weights = rim_weights(positions, 0.01, 1e-3)
    np.testing.assert_allclose(weights, [1, 1, 0.5, 0, 0.25], atol=1e-12)
    traces = np.ones((5, 8))
    out = Conditioning(rim=1e-3).apply(traces, positions, sampling_interval=DT, aperture=0.01)
    np.testing.assert_allclose(out[:, 3], weights, atol=1e-6)
    with pytest.raises(InvalidInput, match="rim"):
        Conditioning(rim=1e-3).apply(traces, sampling_interval=DT)


@pytest.mark.parametrize(
    "bad",
    [
        {"zero_first": -1},
        {"remove_common": "mode"},
        {"rim": -1.0},
        {"band": (5e6, 1e6)},
        {"response": ([1.0, 0.0], [1.0, 1.0])},
        {"delay": np.nan},
    ],
)
def test_impossible_chains_are_refused(bad: dict[str, Any]) -> None:
    with pytest.raises(InvalidInput) as caught:
        Conditioning(**bad)
    assert caught.value.field in bad


def test_display_compensates_envelops_and_compresses() -> None:
    z = np.arange(512) * 10e-6
    line = np.exp(-(((z - 2.5e-3) / 0.3e-3) ** 2)) * np.cos(2 * np.pi * z / 0.1e-3)
    volume = Volume(
        np.tile(line, (2, 3, 1)).astype(np.float32), VoxelAxes(np.arange(2.0), np.arange(3.0), z), (1.0, 1.0, 1e-5)
    )
    envelope = Display(envelope=True).apply(volume).values[1, 2]
    np.testing.assert_allclose(envelope, np.exp(-(((z - 2.5e-3) / 0.3e-3) ** 2)), atol=0.01)
    gained = Display(gain_db_per_mm=20.0).apply(volume).values[0, 0]
    np.testing.assert_allclose(gained[250], 10**2.5 * line[250], rtol=1e-4)
    decibels = Display(envelope=True, log_range_db=40).apply(volume).values
    assert decibels.max() == 0
    assert decibels.min() == pytest.approx(-40)
    with pytest.raises(InvalidInput):
        Display(log_range_db=0)
