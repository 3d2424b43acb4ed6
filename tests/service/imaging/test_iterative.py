"""Iterative reconstruction: better volumes from few sensors, and the rules by which it ends."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest

from fabry_perot.simulator.phantoms import Balls, initial_pressure, pressure, yarn
from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.imaging import Iterative
from steradian.imaging.iterative.proximal import proximal
from steradian.imaging.signal.bandwidth import decimate, decimation_factor, signal_band, sinc_upsample
from steradian.masks import equi_steradian_mask
from steradian.quality import correlation
from support.flat import flat_fit, flat_reconstruct

SIDE, DEPTH, SPEED, INTERVAL, SAMPLES = 5.04e-3, 1.4e-3, 1500.0, 10e-9, 420
COMMON: dict[str, Any] = {
    "sampling_interval": INTERVAL,
    "sound_speed": SPEED,
    "aperture": SIDE,
    "modes": 84,
    "depth_range": (0.3e-3, 2.7e-3),
}


def scene(seed: int) -> tuple[Any, Balls, np.ndarray]:
    """The paper's yarn and mask at 0.37 of their size: balls as large, as many sensors an area, 30 dB peak noise."""
    mask = equi_steradian_mask(SIDE, DEPTH, 222)
    balls = yarn(seed, centre=(0.0, 0.0, DEPTH), radius=1.1e-3)
    traces = pressure(balls, mask.positions, np.arange(SAMPLES) * INTERVAL, SPEED)
    noise = np.random.default_rng(seed).standard_normal(traces.shape) * np.abs(traces).max() * 10**-1.5
    return mask, balls, (traces + noise).astype(np.float32)


@pytest.mark.long
def test_from_few_sensors_the_volume_s_correlation_rises_by_a_tenth_and_the_projection_s_does_not_fall() -> None:
    mask, balls, traces = scene(0)
    direct = flat_reconstruct(traces, mask.positions, weights=mask.weights, **COMMON)
    found = flat_fit(traces, mask.positions, options=Iterative("total-variation", iterations=15), **COMMON)
    axes = direct.axes
    assert axes.y is not None
    truth = initial_pressure(balls, axes.x, axes.y, axes.z)
    assert found.values.shape == direct.values.shape
    np.testing.assert_allclose(found.axes.z, axes.z)
    np.testing.assert_allclose(found.axes.x, axes.x)
    assert found.values.min() >= 0
    assert correlation(found.values, truth) > correlation(direct.values, truth) + 0.10
    assert correlation(found.mip(), truth.max(axis=2)) >= correlation(direct.mip(), truth.max(axis=2))
    assert found.info.decimation > 1
    assert len(found.info.residuals) == found.info.iterations
    assert found.info.products == 1 + 2 * 6 + 2 * (found.info.iterations - 1)


@pytest.mark.parametrize("kind", ["thresholding", "none"])
def test_noise_of_single_sensors_is_not_explained_at_the_film_and_at_the_end_of_the_record(kind: Any) -> None:
    """With a depth range that is asked for it is. What remains is what the interpolation over depths leaves."""
    rng, mask = np.random.default_rng(2), equi_steradian_mask(SIDE, DEPTH, 60)
    ball = Balls(np.array([[0.2e-3, -0.3e-3, DEPTH]]), np.array([0.12e-3]), np.array([1.0]))
    traces = pressure(ball, mask.positions, np.arange(130) * 16e-9, SPEED)
    traces += rng.standard_normal(traces.shape) * np.abs(traces).max() * 10**-0.75
    about = {"sampling_interval": 16e-9, "sound_speed": SPEED, "aperture": SIDE, "modes": 32}
    options, half = Iterative(kind, iterations=8), np.sqrt(np.prod(np.ptp(mask.positions, axis=0)) / 60) / 2
    found, whole = (
        flat_fit(traces, mask.positions, options=options, depth_range=depths, **about)
        for depths in (None, (0.0, 129 * 16e-9 * SPEED))
    )
    ends = (found.axes.z < half) | (found.axes.z > found.axes.z[-1] - half)
    assert found.axes.z[0] == 0
    truth = initial_pressure(ball, found.axes.x, found.axes.y, found.axes.z)
    assert correlation(found.values, truth) > correlation(whole.values, truth)
    left, before = (np.abs(image.values[..., ends]).max() for image in (found, whole))
    assert left < 0.5 * before
    assert any("half the sensors' mean spacing" in note for note in found.info.notes)


def ball_on_a_line() -> tuple[np.ndarray, np.ndarray]:
    where = np.linspace(-2e-3, 2e-3, 40)
    ct = np.arange(200) * 40e-9 * SPEED
    r = np.hypot(where - 0.3e-3, 1.2e-3)[:, None]
    return where, ((r - ct) * np.exp(-((r - ct) ** 2) / (2 * 0.12e-3**2)) / r).astype(np.float32)


LINE: dict[str, Any] = {"sampling_interval": 40e-9, "sound_speed": SPEED, "aperture": 4e-3, "modes": 64}


@pytest.mark.parametrize("kind", ["total-variation", "sparsity", "tikhonov", "none", "thresholding"])
def test_every_regulariser_finds_the_object_in_a_plane(kind: Any) -> None:
    where, traces = ball_on_a_line()
    for non_negative in (True, False):
        options = Iterative(regularisation=kind, non_negative=non_negative, iterations=25)
        volume = flat_reconstruct(traces, where, method="iterative", iterative=options, **LINE)
        peak = np.unravel_index(volume.values.argmax(), volume.values.shape)
        assert volume.axes.x[peak[0]] == pytest.approx(0.3e-3, abs=0.1e-3)
        assert volume.axes.z[peak[1]] == pytest.approx(1.2e-3, abs=0.1e-3)
        assert (volume.values.min() < 0) != non_negative


@pytest.mark.parametrize("kind", ["sparsity", "tikhonov", "none"])
def test_proximal_step_keeps_negative_values_only_where_they_are_allowed(kind: Any) -> None:
    values = np.array([[-2.0, -0.5, 0.0, 0.5, 2.0]])
    for non_negative in (True, False):
        step = proximal(kind, non_negative=non_negative, shape=values.shape, spacing=(1.0, 1.0), threads=1)
        found = np.empty_like(values)
        step(values.copy(), found, 0.25)
        assert (found.min() < 0) != non_negative
        assert found.max() > 1


def test_iteration_stops_at_discrepancy_change_or_iteration_limit() -> None:
    where, traces = ball_on_a_line()
    noisy = traces + np.random.default_rng(0).normal(0, 0.02, traces.shape).astype(np.float32)
    plain: dict[str, Any] = {"regularisation": "none", "iterations": 200, "change": 0.0}
    at_noise = flat_fit(noisy, where, options=Iterative(**plain), **LINE)
    assert at_noise.info.stop_reason == "discrepancy"
    assert at_noise.info.iterations < 200
    told = flat_fit(noisy, where, options=Iterative(**plain, noise=0.2), **LINE)
    assert told.info.stop_reason == "discrepancy"
    assert told.info.iterations < at_noise.info.iterations
    rest = Iterative(regularisation="tikhonov", iterations=500, discrepancy=None)
    assert flat_fit(noisy, where, options=rest, **LINE).info.stop_reason == "change"
    few = flat_fit(noisy, where, options=Iterative("total-variation", iterations=3, discrepancy=None), **LINE)
    assert (few.info.stop_reason, few.info.iterations) == ("iterations", 3)
    assert list(few.info.residuals) == sorted(few.info.residuals, reverse=True)


def test_a_scale_multiplies_the_image_and_the_depth_range_cuts_it() -> None:
    where, traces = ball_on_a_line()
    plain = flat_fit(traces, where, options=Iterative("total-variation", iterations=5), **LINE)
    scaled = flat_fit(traces, where, options=Iterative("total-variation", iterations=5), scale=4.0, **LINE)
    np.testing.assert_allclose(scaled.values, 4 * plain.values, atol=1e-3 * scaled.values.max())
    part = flat_fit(
        traces,
        where,
        options=Iterative("total-variation", iterations=5),
        depth_range=(0.5e-3, 2e-3),
        upsampling=2,
        **LINE,
    )
    assert part.values.shape == (128, len(part.axes.z))
    assert part.axes.z[0] >= 0.5e-3
    assert part.axes.z[-1] <= 2e-3
    assert part.spacing[0] == pytest.approx(plain.spacing[0] / 2)


def test_it_reports_cancels_and_refuses() -> None:
    where, traces = ball_on_a_line()
    told: list[tuple[str, int, int]] = []
    flat_fit(
        traces,
        where,
        options=Iterative("total-variation", iterations=4, discrepancy=None),
        progress=lambda *a: told.append(a),
        **LINE,
    )
    assert told[0] == ("iterations", 0, 4)
    assert told[-1][0].startswith("iterations, misfit ")
    assert told[-1][1:] == (4, 4)
    with pytest.raises(Cancelled):
        flat_fit(traces, where, cancelled=lambda: True, **LINE)
    with pytest.raises(InvalidInput, match="memory_limit"):
        flat_fit(traces, where, memory_limit=1000, **LINE)
    for bad in ({"regularisation": "hope"}, {"iterations": 0}, {"change": 1.0}, {"strength": -1.0}):
        with pytest.raises(InvalidInput, match=next(iter(bad))):
            Iterative(**bad)  # type: ignore[arg-type]


@pytest.mark.long
def test_a_run_stays_within_the_memory_it_states() -> None:
    mask, _, traces = scene(0)
    for upsampling in (1, 2):
        arguments: dict[str, Any] = {
            "options": Iterative("total-variation", iterations=3),
            "upsampling": upsampling,
            **COMMON,
        }
        flat_fit(traces, mask.positions, **arguments)  # compiles, which takes memory of its own
        tracemalloc.start()
        found = flat_fit(traces, mask.positions, **arguments)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert 0.5 * found.info.memory_bytes < peak <= found.info.memory_bytes


def test_the_band_of_noisy_traces_and_their_noise_are_found() -> None:
    _, _, traces = scene(1)
    highest, noise = signal_band(traces, INTERVAL)
    assert 7e6 < highest < 16e6  # balls of 45 µm
    clean = traces - np.median(traces)
    assert noise == pytest.approx(np.std(clean[:, -40:]), rel=0.1)
    assert decimation_factor(highest, INTERVAL) in (2, 3, 4, 5)


def test_thinned_traces_are_the_same_signal_and_refining_undoes_it() -> None:
    n = np.arange(300)
    signal = np.exp(-(((n - 150) / 20.0) ** 2)) * np.cos(0.3 * n)
    thin = decimate(np.tile(signal, (3, 1)), 4, "float64")
    np.testing.assert_allclose(thin[0], signal[::4], atol=1e-6)
    np.testing.assert_allclose(sinc_upsample(thin, (1, 4))[0], signal, atol=1e-6)
