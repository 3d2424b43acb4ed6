"""Forward operator and its transpose: the physics, the direct sums, and the products' agreement."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest
from scipy.sparse.linalg import LinearOperator, lsqr

from fabry_perot.simulator.phantoms import Balls, initial_pressure, pressure
from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.imaging.operators import ForwardOperator
from support.flat import flat_operator, flat_reconstruct

RNG = np.random.default_rng(0)
SETTING: dict[str, Any] = {
    "samples": 45,
    "sampling_interval": 1e-7,
    "sound_speed": 1500.0,
    "depth_range": (0.6e-3, 5e-3),
    "time_zero": 2.3e-7,
}
CASES = [
    ((10, 12), (1e-2, 1.3e-2), False, 1.0),
    ((10, 10), (1e-2, 1e-2), False, 1.3),
    ((10, 10), (1e-2, 1e-2), True, 1.0),
    ((9, 11), (1e-2, 1e-2), False, 1.0),
    ((20,), (1e-2,), False, 1.5),
    ((21,), (1e-2,), True, 1.5),
]


def sensors(modes: tuple[int, ...], aperture: tuple[float, ...], on_grid: bool, count: int = 30) -> np.ndarray:
    if on_grid:
        axes = [(RNG.integers(0, n, count) - n // 2) * X / n for n, X in zip(modes, aperture, strict=True)]
        return np.stack(axes, axis=1)
    return (RNG.random((count, len(modes))) - 0.5) * np.array(aperture)


def direct(operator: ForwardOperator, volume: np.ndarray, response: Any = None) -> np.ndarray:
    """The documented sums, term by term in float64."""
    g = operator.geometry
    L, t = g.record, np.arange(g.samples) + g.time_zero / g.sampling_interval
    whole = np.zeros((*g.padded_modes, L))
    at = [(np.arange(n) - n // 2) % p for n, p in zip(g.modes, g.padded_modes, strict=True)]
    whole[np.ix_(*at, np.arange(*g.depth))] = volume
    lateral = np.fft.fftn(whole, axes=tuple(range(len(g.modes)))).reshape(-1, L)
    numbers = np.stack(np.meshgrid(*(np.fft.fftfreq(p, 1 / p) for p in g.padded_modes), indexing="ij"), axis=-1)
    l = np.arange(-((L - 1) // 2), (L - 1) // 2 + 1)  # noqa: E741
    depth = np.exp(-2j * np.pi * np.outer(l, np.arange(L)) / L)
    total = np.zeros(operator.trace_shape)
    for j, column in zip(numbers.reshape(-1, len(g.modes)), lateral, strict=True):
        if (2 * np.abs(j) == np.array(g.padded_modes)).any():
            continue
        kappa = np.sqrt(l**2 + np.sum((L * g.depth_step / np.array(g.period) * j) ** 2))
        some = kappa < L / 2
        film = np.ones(some.sum(), complex)
        if response is not None:
            across = np.sqrt(np.maximum(kappa**2 - l**2, 0)) / np.maximum(kappa, 1e-9)
            film = response.pointwise(kappa[some] / (L * g.sampling_interval), across[some])
        turning = 2 * np.pi * np.outer(t, kappa[some]) / L + np.angle(film)
        series = (np.abs(film) * np.cos(turning)) @ (depth[some] @ column)
        total += np.real(np.exp(2j * np.pi * g.positions @ (j / np.array(g.period)))[:, None] * series)
    return total / (np.prod(g.padded_modes) * L)


@pytest.mark.long
@pytest.mark.parametrize(("modes", "aperture", "on_grid", "padding"), CASES)
def test_both_products_agree_and_are_the_direct_sums(
    modes: tuple[int, ...], aperture: tuple[float, ...], on_grid: bool, padding: float
) -> None:
    operator = flat_operator(
        sensors(modes, aperture, on_grid), aperture=aperture, modes=modes, lateral_padding=padding, tolerance=1e-8,
        dtype="float64", **SETTING,
    )  # fmt: skip
    volume, traces = RNG.standard_normal(operator.volume_shape), RNG.standard_normal(operator.trace_shape)
    there, back = operator.forward(volume), operator.backward(traces)
    assert abs(np.vdot(there, traces) - np.vdot(volume, back)) <= 1e-11 * np.linalg.norm(there) * np.linalg.norm(traces)
    expected = direct(operator, volume)
    assert np.linalg.norm(there - expected) <= 1e-8 * np.linalg.norm(expected)


def test_in_single_precision_the_products_agree_to_its_rounding() -> None:
    operator = flat_operator(sensors((32, 32), (1e-2, 1e-2), False), aperture=1e-2, modes=32, **SETTING)
    volume, traces = RNG.standard_normal(operator.volume_shape), RNG.standard_normal(operator.trace_shape)
    there, back = operator.forward(volume), operator.backward(traces)
    assert there.dtype == back.dtype == np.float32
    assert abs(np.vdot(there, traces) - np.vdot(volume, back)) <= 1e-6 * np.linalg.norm(there) * np.linalg.norm(traces)


class Smooth:
    """A response with a loss and a delay that grow with frequency and angle."""

    def evaluate(self, frequencies: np.ndarray, sines: np.ndarray, sound_speed: float) -> np.ndarray:
        return self.pointwise(frequencies[:, None], sines[None, :])

    def pointwise(self, frequency: np.ndarray, sine: np.ndarray) -> np.ndarray:
        return (1 - 0.5 * sine**2) / (1 + 1j * frequency / 3e6) * np.exp(-2j * np.pi * frequency * 2e-8 * sine)


@pytest.mark.long
def test_the_film_s_response_is_part_of_both_products() -> None:
    film = Smooth()
    operator = flat_operator(
        sensors((12, 12), (1e-2, 1e-2), False, 6), aperture=1e-2, modes=12, response=film, tolerance=1e-8,
        lateral_padding=1.0, dtype="float64", **SETTING,
    )  # fmt: skip
    volume, traces = RNG.standard_normal(operator.volume_shape), RNG.standard_normal(operator.trace_shape)
    there, back = operator.forward(volume), operator.backward(traces)
    assert np.vdot(there, traces) == pytest.approx(np.vdot(volume, back), rel=1e-9)
    expected = direct(operator, volume, film)
    assert np.linalg.norm(there - expected) < 1e-3 * np.linalg.norm(expected)  # its table is interpolated


def test_the_model_s_a_lines_are_the_closed_form_sound_of_balls() -> None:
    side, speed, interval, samples = 5e-3, 1500.0, 25e-9, 130
    centres = np.array([[0.0, 0.0, 1.2e-3], [1.3e-3, -0.5e-3, 1.6e-3], [-1.8e-3, 2.0e-3, 0.9e-3]])
    balls = Balls(centres, np.array([0.1e-3, 0.12e-3, 0.1e-3]), np.array([1.0, 0.6, 0.8]))
    where = sensors((1, 1), (side, side), False, 200)
    common: dict[str, Any] = {
        "samples": samples, "sampling_interval": interval, "sound_speed": speed, "aperture": side, "modes": 64,
        "depth_range": (0.3e-3, 2.3e-3),
    }  # fmt: skip
    truth = pressure(balls, where, np.arange(samples) * interval, speed)
    operator = flat_operator(where, **common)
    axes = operator.geometry.axes()
    found = operator.forward(initial_pressure(balls, axes.x, axes.y, axes.z))
    assert np.linalg.norm(found - truth) < 0.01 * np.linalg.norm(truth)
    # without the padding, copies of the balls a period away are heard
    wrapped = flat_operator(where, lateral_padding=1.0, **common).forward(
        initial_pressure(balls, axes.x, axes.y, axes.z)
    )
    assert np.linalg.norm(wrapped - truth) > 0.3 * np.linalg.norm(truth)


def test_with_sensors_everywhere_the_direct_formula_undoes_the_model() -> None:
    axis = (np.arange(48) - 24) * 5e-3 / 48
    where = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    common: dict[str, Any] = {"sampling_interval": 40e-9, "sound_speed": 1500.0, "aperture": 5e-3, "modes": 48}
    operator = flat_operator(where, samples=200, lateral_padding=1.0, **common)  # everywhere: sensors repeat, too
    axes = operator.geometry.axes()
    flat = Balls(np.array([[0.0, 0.0, 1.5e-3]]), np.array([0.25e-3]), np.array([1.0]))
    ball = initial_pressure(flat, axes.x, axes.y, axes.z)
    back = flat_reconstruct(operator.forward(ball), where, time_padding=2.0, **common)
    # model and formula are periodic, so that all but the waves along the film are heard and put back
    assert 0.8 < back.values.max() < 1.0
    assert np.corrcoef(back.values.ravel(), ball.ravel())[0, 1] > 0.9


def test_a_padding_that_no_transform_takes_is_refused() -> None:
    """A record of 36 mm over an aperture of 2 mm needs the volume 18.5 times as wide; 1 makes the medium periodic."""
    common: dict[str, Any] = {"samples": 300, "sampling_interval": 80e-9, "sound_speed": 1500.0, "modes": 8}
    with pytest.raises(InvalidInput, match=r"lateral_padding is 18.5, .* allowed: at most 16"):
        flat_operator(np.zeros((1, 2)), aperture=2e-3, **common)
    assert flat_operator(np.zeros((1, 2)), aperture=2e-3, lateral_padding=1.0, **common).shape[0] == 300


@pytest.mark.parametrize("count", [30, 3000])
def test_a_product_takes_the_memory_that_is_stated(count: int) -> None:
    operator = flat_operator(
        sensors((48, 48), (1e-2, 1e-2), False, count), aperture=1e-2, modes=48, lateral_padding=1.5, threads=2,
        **{**SETTING, "samples": 400},
    )  # fmt: skip
    volume, traces = (np.ones(shape, np.float32) for shape in (operator.volume_shape, operator.trace_shape))
    peaks = []
    for product, given in ((operator.forward, volume), (operator.backward, traces)):
        product(given)
        tracemalloc.start()
        product(given)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert 0.7 * operator.memory_bytes < max(peaks) <= operator.memory_bytes + 2**20


def test_it_is_a_scipy_operator_and_solvers_take_it() -> None:
    where = sensors((12, 12), (1e-2, 1e-2), False, 200)
    operator = flat_operator(where, aperture=1e-2, modes=12, dtype="float64", **SETTING)
    assert isinstance(operator, LinearOperator)
    assert operator.shape == (200 * 45, 12 * 12 * operator.volume_shape[-1])
    x = RNG.standard_normal(operator.shape[1])
    traces = operator @ x
    np.testing.assert_allclose(operator.T @ traces, operator.backward(traces.reshape(operator.trace_shape)).ravel())
    solution = lsqr(operator, traces, iter_lim=30)[0]
    assert np.linalg.norm(operator @ solution - traces) < 0.05 * np.linalg.norm(traces)


def test_wrong_input_is_refused_and_work_is_cancelled() -> None:
    operator = flat_operator(sensors((12, 12), (1e-2, 1e-2), False), aperture=1e-2, modes=12, **SETTING)
    with pytest.raises(InvalidInput, match="volume"):
        operator.forward(np.zeros((2, 2, 2)))
    with pytest.raises(InvalidInput, match="max_frequency"):
        flat_operator(np.zeros((1, 2)), aperture=1e-2, modes=12, highest_frequency=0.0, **SETTING)
    with pytest.raises(InvalidInput, match=r"max_frequency is signal; .*reconstruct"):
        flat_operator(np.zeros((1, 2)), aperture=1e-2, modes=12, highest_frequency="signal", **SETTING)
    with pytest.raises(Cancelled):
        operator.forward(np.zeros(operator.volume_shape), cancelled=lambda: True)
