"""Parametric transforms: derivatives by sensor positions, sound speed and time zero against direct sums."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from steradian.core.exceptions import InvalidInput
from steradian.imaging import (
    AcquisitionGeometry,
    Attenuation,
    Compute,
    ElasticFilm,
    ImageGrid,
    InverseFilter,
    Layer,
    Medium,
    Nufft,
    ReconstructionPlan,
)
from steradian.imaging.engines.cuda import array_backend
from steradian.imaging.operators import ForwardOperator
from steradian.imaging.parametric.models import parametric_forward_model, parametric_inversion
from steradian.imaging.parametric.transform import ParametricTransform
from steradian.imaging.signal.attenuation import attenuation_derivatives, attenuation_matrix

SIDE, DT, SPEED, BEGINS, SAMPLES = 2e-3, 2e-8, 1500.0, 1.1e-7, 24
RNG = np.random.default_rng(0)
PLACES = (RNG.random((6, 2)) - 0.5) * 0.95 * SIDE
EXACT = Compute(dtype="float64")
GRID = ImageGrid(modes=(7, 5), depth=(1e-4, 6e-4))
LAYERS = Medium([Layer(1480.0, thickness=2.3e-4), Layer(1540.0, attenuation=Attenuation(0.75, 1.5))])


def geometry(**other: Any) -> AcquisitionGeometry:
    settings = {"dt": DT, "t0": BEGINS, "aperture": SIDE, "sound_speed": SPEED, "weights": np.full(6, 1e-7)}
    settings |= other
    if "medium" in other:
        del settings["sound_speed"]
    return AcquisitionGeometry(settings.pop("sensors", PLACES), SAMPLES, **settings)


def model(**other: Any) -> ParametricTransform:
    return parametric_forward_model(geometry(**other), GRID, tolerance=1e-11, max_frequency=2e7, compute=EXACT)


def inversion() -> ParametricTransform:
    grid = replace(GRID, depth=None)
    return parametric_inversion(geometry(), grid, Nufft(tolerance=1e-11, max_frequency=2e7), compute=EXACT)


def direct(transform: ParametricTransform, image: np.ndarray, by: str) -> np.ndarray:
    """K f by the documented sums, wave by wave, or its derivative by "x", "y", "speed" or "time"; "" for none."""
    g, rising = transform.geometry, transform.variation.exponent == 1
    height = g.depth_points * g.depth_step
    times = g.time_zero + np.arange(g.samples) * g.sampling_interval
    x, y = ((np.arange(n) - n // 2) * X / n for n, X in zip(g.modes, g.aperture, strict=True))
    z = np.arange(*g.depth) * g.depth_step
    norm = np.prod(g.padded_modes) * g.depth_points
    if rising:
        point = np.prod([X / n for X, n in zip(g.period, g.padded_modes, strict=True)])
        norm *= point * g.depth_step / (g.sound_speed * g.sampling_interval)
    found = np.zeros(transform.trace_shape, complex)
    for j, k in np.ndindex(*g.padded_modes):
        numbers = [n - p // 2 for n, p in zip((j, k), g.padded_modes, strict=True)]
        if any(2 * abs(n) == p for n, p in zip(numbers, g.padded_modes, strict=True)):
            continue
        across = 2 * np.pi * np.array(numbers) / np.array(g.period)
        column = np.einsum("xyz,x,y->z", image, np.exp(-1j * across[0] * x), np.exp(-1j * across[1] * y))
        there = np.exp(1j * g.positions @ across) * {"x": 1j * across[0], "y": 1j * across[1]}.get(by, 1.0)
        for up in np.arange(g.depth_points // 2 + 1) / height:
            steep = np.hypot(up, np.linalg.norm(across) / (2 * np.pi))
            if steep * height >= g.band * (1 - 1e-12):
                continue
            turns = 2 * np.pi * steep * times  # per m/s
            wave = np.exp(1j * g.sound_speed * turns)
            by_time = 2j * np.pi * steep * g.sound_speed
            wave = wave * {"speed": 1j * turns + rising / g.sound_speed, "time": by_time}.get(by, 1.0)
            both = 2 if up else 1
            if rising:
                factor = both * (2 * up / steep if steep else 2.0) * (column @ np.exp(-2j * np.pi * up * z))
            else:
                factor, wave = both * (column @ np.cos(2 * np.pi * up * z)), wave.real
            found += factor * np.outer(there, wave)
    return found.real / norm


@pytest.mark.parametrize("make", [model, inversion])
@pytest.mark.parametrize("by", ["", "x", "y", "speed", "time"])
def test_derivatives_are_those_of_the_direct_sums(make: Callable[[], ParametricTransform], by: str) -> None:
    transform = make()
    at, image = transform.at(transform.parameters()), RNG.standard_normal(transform.volume_shape)
    expected = direct(transform, image, by)
    if by in ("x", "y"):
        found = at.positions_to_traces(image)["xy".index(by)]
    else:
        found = {"": at.to_traces, "speed": lambda f: at.speeds_to_traces(f)[0], "time": at.time_to_traces}[by](image)
    assert np.linalg.norm(found - expected) <= 1e-8 * np.linalg.norm(expected)


@pytest.mark.parametrize("make", [model, inversion, lambda: model(medium=LAYERS)])
def test_derivatives_of_both_products_are_transposes(make: Callable[[], ParametricTransform]) -> None:
    transform = make()
    at = transform.at(transform.parameters(PLACES[::-1], time_zero=1.05 * BEGINS))
    image, traces = RNG.standard_normal(transform.volume_shape), RNG.standard_normal((2, *transform.trace_shape))
    pairs = [
        (at.to_traces(image), traces[0], at.to_image(traces[0])),
        (at.positions_to_traces(image), traces, at.positions_to_image(traces)),
        (at.time_to_traces(image), traces[0], at.time_to_image(traces[0])),
    ]
    pairs += [
        (there, traces[0], back)
        for there, back in zip(at.speeds_to_traces(image), at.speeds_to_image(traces[0]), strict=True)
    ]
    for there, given, back in pairs:
        size = np.linalg.norm(there) * np.linalg.norm(given)
        assert abs(np.vdot(there, given) - np.vdot(image, back)) <= 1e-11 * size


@pytest.mark.parametrize("medium", [Medium([Layer(SPEED)]), LAYERS])
def test_model_with_moved_sensors_is_the_forward_operator_of_those_sensors(medium: Medium) -> None:
    elsewhere, later = 0.9 * PLACES[::-1], 1.04 * BEGINS
    grid = replace(GRID, lateral_padding=3.0)
    transform = parametric_forward_model(geometry(medium=medium), grid, tolerance=1e-9, compute=EXACT)
    operator = ForwardOperator(
        geometry(medium=medium, sensors=elsewhere, t0=later), grid, tolerance=1e-9, compute=EXACT
    )
    image = RNG.standard_normal(transform.volume_shape)
    image[..., 0] = 0  # a jump at a boundary rings, and differently in records of different lengths
    found = transform.at(transform.parameters(elsewhere, time_zero=later)).to_traces(image)
    expected = operator.forward(image)
    allowed = 1e-8 if len(medium.layers) == 1 else 1e-3
    assert np.linalg.norm(found - expected) <= allowed * np.linalg.norm(expected)


def test_derivatives_on_a_gpu_are_the_processor_s(monkeypatch: pytest.MonkeyPatch) -> None:
    if array_backend.unavailable_reason():
        monkeypatch.setenv(array_backend.USE_SIMULATOR, "simulator")
    few, grid = geometry(medium=Medium([Layer(SPEED)])), ImageGrid(modes=(3, 4), depth=(1e-4, 3e-4), lateral_padding=1)
    there, here = (
        parametric_forward_model(few, grid, tolerance=1e-2, compute=replace(EXACT, device=device))
        for device in ("gpu", "cpu")
    )
    image = RNG.standard_normal(here.volume_shape)
    for name in ("to_traces", "positions_to_traces", "time_to_traces", "speeds_to_traces"):
        expected = getattr(here.at(here.parameters()), name)(image)
        found = getattr(there.at(there.parameters()), name)(image)
        assert np.linalg.norm(found - expected) <= 1e-12 * np.linalg.norm(expected)


@pytest.mark.parametrize("medium", [Medium([Layer(SPEED)]), LAYERS])
@pytest.mark.parametrize("depth", [None, GRID.depth])
def test_moved_sensors_alone_leave_the_model_as_it_is(medium: Medium, depth: Any) -> None:
    """Also without a range of depths, and with the padding that nothing is said of."""
    grid = ImageGrid(modes=(8, 6), depth=depth)
    operator = ForwardOperator(geometry(medium=medium), grid, tolerance=1e-9, compute=EXACT)
    transform = parametric_forward_model(geometry(medium=medium), grid, tolerance=1e-9, compute=EXACT, reach=1.0)
    longer = parametric_forward_model(geometry(medium=medium), grid, tolerance=1e-9, compute=EXACT)
    assert transform.volume_shape == longer.volume_shape == operator.volume_shape
    image = RNG.standard_normal(operator.volume_shape)
    found, expected = transform.at(transform.parameters()).to_traces(image), operator.forward(image)
    assert np.linalg.norm(found - expected) <= 1e-7 * np.linalg.norm(expected)


def test_inversion_with_weights_is_the_reconstruction() -> None:
    grid, method = ImageGrid(modes=(7, 5)), Nufft(tolerance=1e-9)
    transform = parametric_inversion(geometry(), grid, method, compute=EXACT)
    traces = RNG.standard_normal(transform.trace_shape)
    expected = ReconstructionPlan(geometry(), grid, method, compute=EXACT).run(traces).values
    found = transform.at(transform.parameters()).to_image(transform.geometry.weights[:, None] * traces)
    assert np.linalg.norm(found - expected) <= 1e-8 * np.linalg.norm(expected)


@pytest.mark.parametrize("by", ["", "x", "y"])
def test_waves_at_the_nyquist_frequency_of_even_modes_are_left_out_of_the_model(by: str) -> None:
    """Which alternate from voxel to voxel, so that their direction, and a derivative by positions, has no sign."""
    grid = replace(GRID, modes=(8, 6), lateral_padding=1.0)
    transform = parametric_forward_model(geometry(), grid, tolerance=1e-11, max_frequency=2e7, compute=EXACT)
    assert all(n % 2 == 0 for n in transform.geometry.padded_modes)
    at, image = transform.at(transform.parameters()), RNG.standard_normal(transform.volume_shape)
    found = at.positions_to_traces(image)["xy".index(by)] if by else at.to_traces(image)
    expected = direct(transform, image, by)
    assert np.linalg.norm(found - expected) <= 1e-8 * np.linalg.norm(expected)
    if not by:
        operator = ForwardOperator(geometry(), grid, tolerance=1e-11, max_frequency=2e7, compute=EXACT)
        assert np.linalg.norm(found - operator.forward(image)) <= 1e-7 * np.linalg.norm(expected)


def test_waves_at_the_nyquist_frequency_of_even_modes_are_all_that_differs_from_the_reconstruction() -> None:
    grid, method = ImageGrid(modes=(8, 6)), Nufft(tolerance=1e-9)
    transform = parametric_inversion(geometry(), grid, method, compute=EXACT)
    traces = RNG.standard_normal(transform.trace_shape)
    plan = ReconstructionPlan(geometry(), grid, method, compute=EXACT)
    expected = np.fft.fft2(plan.run(traces).values, axes=(0, 1))
    image = transform.at(transform.parameters()).to_image(transform.geometry.weights[:, None] * traces)
    found = np.fft.fft2(image, axes=(0, 1))
    assert np.linalg.norm(expected[4]) > 1e-3 * np.linalg.norm(expected)
    expected[4], expected[:, 3] = 0, 0
    assert np.linalg.norm(found - expected) <= 1e-8 * np.linalg.norm(expected)


def test_derivative_of_a_film_s_response_by_speed_is_the_difference_quotient() -> None:
    film = ElasticFilm()
    transform = parametric_forward_model(
        geometry(), GRID, response=film, tolerance=1e-11, max_frequency=2e7, compute=EXACT
    )
    image, h = RNG.standard_normal(transform.volume_shape), 0.05
    more, less = (transform.at(transform.parameters(sound_speed=SPEED + d)).to_traces(image) for d in (h, -h))
    found = transform.at(transform.parameters()).speeds_to_traces(image)[0]
    assert np.linalg.norm(found - (more - less) / (2 * h)) < 2e-3 * np.linalg.norm(found)


def test_derivatives_of_the_attenuation_matrix_are_difference_quotients() -> None:
    def matrix(speed: float, begins: float) -> np.ndarray:
        medium = Medium([Layer(speed, attenuation=Attenuation(0.75, 1.5))])
        return attenuation_matrix(medium, samples=40, interval=DT, time_zero=begins)

    medium = Medium([Layer(SPEED, attenuation=Attenuation(0.75, 1.5))])
    by_speed, by_time = attenuation_derivatives(medium, samples=40, interval=DT, time_zero=BEGINS)
    h, s = 1.0, 1e-3 * DT
    expected = (matrix(SPEED + h, BEGINS) - matrix(SPEED - h, BEGINS)) / (2 * h)
    assert np.linalg.norm(by_speed - expected) < 1e-5 * np.linalg.norm(expected)
    expected = (matrix(SPEED, BEGINS + s) - matrix(SPEED, BEGINS - s)) / (2 * s)
    assert np.linalg.norm(by_time - expected) < 1e-5 * np.linalg.norm(expected)


@pytest.mark.parametrize(
    ("field", "given"),
    [
        ("positions", {"positions": PLACES[:3]}),
        ("positions", {"positions": PLACES + SIDE}),
        ("positions", {"positions": PLACES * np.nan}),
        ("sound_speed", {"sound_speed": 1700.0}),
        ("sound_speed", {"sound_speed": -1.0}),
        ("time_zero", {"time_zero": 1e-6}),
    ],
)
def test_parameters_out_of_range_are_refused(field: str, given: dict[str, Any]) -> None:
    with pytest.raises(InvalidInput) as refused:
        model().parameters(**given)
    assert refused.value.field == field


@pytest.mark.parametrize(("speeds", "varied"), [((1480.0, 1540.0), 1), ((1540.0, 1480.0), 0)])
def test_derivative_by_a_layer_s_speed_is_that_of_the_forward_operator(speeds: tuple[float, ...], varied: int) -> None:
    """Of the faster layer, whose speed leaves the voxels of the forward operator where they are."""

    def medium(change: float) -> Medium:
        first, second = (speed + change * (i == varied) for i, speed in enumerate(speeds))
        return Medium([Layer(first, thickness=2.3e-4), Layer(second, attenuation=Attenuation(0.75, 1.5))])

    grid, settings = replace(GRID, lateral_padding=3.0), {"max_frequency": 1.5e7, "compute": EXACT}
    transform = parametric_forward_model(geometry(medium=medium(0.0)), grid, tolerance=1e-11, **settings)
    x, y, z = (np.linspace(-1, 1, n) for n in transform.volume_shape)
    image = np.exp(-4 * (x[:, None, None] ** 2 + y[:, None] ** 2) - 20 * (z - 0.5) ** 2)
    more, less = (
        ForwardOperator(geometry(medium=medium(h)), grid, tolerance=1e-9, **settings).forward(image) for h in (3, -3)
    )
    found = transform.at(transform.parameters()).speeds_to_traces(image)[varied]
    expected = (more - less) / 6
    assert np.linalg.norm(found - expected) < 0.01 * np.linalg.norm(expected)


def test_parameters_and_geometries_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InvalidInput, match="sound_speed"):
        model(medium=LAYERS).parameters(sound_speed=1501.0)
    with pytest.raises(InvalidInput, match="sound_speed"):
        model(medium=LAYERS).parameters(sound_speed=[1480.0, 1700.0])
    transform = model()
    with pytest.raises(InvalidInput, match="values"):
        transform.at(transform.parameters()).to_traces(np.zeros((3, 3, 3)))
    with pytest.raises(InvalidInput, match=r"time_zero.* at most 1\.15\d+e-07 s"):
        transform.parameters(sound_speed=1560.0, time_zero=1.3e-7)
    with pytest.raises(InvalidInput, match="medium"):
        parametric_inversion(geometry(medium=LAYERS), GRID)
    with pytest.raises(InvalidInput, match="upsampling"):
        parametric_inversion(geometry(), ImageGrid(modes=5, upsampling=2))
    with pytest.raises(InvalidInput, match="correction"):
        parametric_inversion(geometry(), GRID, Nufft(correction=InverseFilter(ElasticFilm())))
