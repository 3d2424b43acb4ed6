"""Sensing spot: its response is the mean over the beam, in the model and in the correction.

A-lines are averaged by quadrature over the spot, which the reconstruction does not do.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from steradian.core.exceptions import InvalidInput
from steradian.imaging import (
    Acquisition,
    AcquisitionGeometry,
    Compute,
    ElasticFilm,
    ImageGrid,
    InverseFilter,
    Layer,
    Medium,
    Nufft,
    SensingSpot,
    Volume,
    reconstruct,
)
from steradian.imaging.film_response import tabulate
from steradian.imaging.operators import ForwardOperator
from steradian.masks import equi_steradian_mask
from steradian.phantoms import Balls, averaged_over_spot, initial_pressure, layered_pressure

DT, SAMPLES, SPEED, DEPTH = 15e-9, 260, 1500.0, 2e-3
MEDIUM = Medium([Layer(SPEED)])
LAYERS = Medium([Layer(1480.0, 1e-3, 1000.0), Layer(1580.0, None, 1000.0)])
CPU = Compute(device="cpu")


def simulate(positions: np.ndarray, medium: Medium = MEDIUM, size: float = 40e-6) -> np.ndarray:
    balls = Balls(np.array([(0.0, 0.0, DEPTH)]), np.array([size]), np.ones(1))
    return layered_pressure(balls, positions, medium, samples=SAMPLES, sampling_interval=DT)


@pytest.mark.parametrize("profile", ["gaussian", "top-hat"])
def test_response_is_the_mean_of_a_plane_wave_over_the_beam(profile: Any) -> None:
    spot, frequencies, sines = SensingSpot(100e-6, profile), np.array([0.0, 5e6, 15e6, 30e6]), np.array([0.0, 0.3, 0.9])
    for f, row in zip(frequencies, spot.evaluate(frequencies, sines, SPEED), strict=True):
        for sine, found in zip(sines, row, strict=True):
            k = 2 * np.pi * f * sine / SPEED
            expected = averaged_over_spot(
                lambda where, k=k: np.cos(k * where[:, :1]), np.zeros((1, 2)), diameter=100e-6, profile=profile,
                radii=24, angles=48,
            )  # fmt: skip
            assert found == pytest.approx(expected[0, 0], abs=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("profile", ["gaussian", "top-hat"])
@pytest.mark.parametrize("medium", [MEDIUM, LAYERS], ids=["one medium", "layers"])
def test_model_with_a_spot_gives_the_a_lines_of_the_quadrature(medium: Medium, profile: Any) -> None:
    mask = equi_steradian_mask(6e-3, DEPTH, 60)
    operator = ForwardOperator(
        AcquisitionGeometry(mask, SAMPLES, dt=DT, medium=medium),
        ImageGrid(144, depth=(1.2e-3, 2.8e-3)),
        response=SensingSpot(150e-6, profile),
        compute=CPU,
    )
    axes = operator.geometry.axes()
    assert axes.y is not None
    balls = Balls(np.array([(0.0, 0.0, DEPTH)]), np.array([60e-6]), np.ones(1))
    found = operator.forward(initial_pressure(balls, axes.x, axes.y, axes.z))
    point = simulate(mask.positions, medium, 60e-6)
    truth = averaged_over_spot(
        lambda where: simulate(where, medium, 60e-6), mask.positions, diameter=150e-6, profile=profile
    )
    assert np.linalg.norm(point - truth) > 0.1 * np.linalg.norm(truth)
    assert np.linalg.norm(found - truth) <= 0.01 * np.linalg.norm(truth)


@pytest.mark.parametrize(("dtype", "most"), [("float32", 1e-6), ("float64", 1e-14)])
def test_both_products_with_a_spot_layers_and_film_agree_to_rounding(dtype: str, most: float) -> None:
    rng = np.random.default_rng(0)
    geometry = AcquisitionGeometry(rng.uniform(-1e-3, 1e-3, (25, 2)), 60, dt=25e-9, medium=LAYERS, aperture=2e-3)
    compute, spot = Compute(device="cpu", dtype=dtype), SensingSpot(300e-6, "top-hat", ElasticFilm())
    operator = ForwardOperator(geometry, ImageGrid(8, depth=(0.4e-3, 1.6e-3)), response=spot, compute=compute)
    volume, traces = rng.standard_normal(operator.volume_shape), rng.standard_normal(operator.trace_shape)
    there, back = (each.astype(np.float64) for each in (operator.forward(volume), operator.backward(traces)))
    assert abs(np.vdot(there, traces) - np.vdot(volume, back)) <= most * np.linalg.norm(there) * np.linalg.norm(traces)


def ring(angle: float) -> np.ndarray:
    """Positions of 300 sensors that see the ball at angles within 6° of one."""
    rng = np.random.default_rng(0)
    tilt, turn = np.radians(angle + rng.uniform(-6, 6, 300)), rng.uniform(0, 2 * np.pi, 300)
    return DEPTH * np.tan(tilt)[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)


def widths(volume: Volume) -> np.ndarray:
    """Widths at half of the largest value along x, y and z."""
    top = np.unravel_index(volume.values.argmax(), volume.values.shape)
    found = []
    for axis, (i, step) in enumerate(zip(top, volume.spacing, strict=True)):
        line = np.moveaxis(volume.values, axis, 0)[(slice(None), *np.delete(top, axis))].astype(float)
        fine = np.interp(np.arange(0, len(line) - 1, 0.01), np.arange(len(line)), line)
        above, middle = fine >= line[i] / 2, int(i * 100)
        left = middle - int(np.argmin(above[middle::-1]))
        found.append((int(np.argmin(above[middle:])) + middle - left) * 0.01 * step)
    return np.array(found)


@pytest.mark.parametrize("angle", [30.0, 45.0])
def test_correction_of_a_top_hat_of_100_um_gives_the_width_of_a_point(angle: float) -> None:
    where = ring(angle)
    blurred = averaged_over_spot(simulate, where, diameter=100e-6, profile="top-hat")
    images = {}
    for name, traces, method in (
        ("point", simulate(where), Nufft()),
        ("blurred", blurred, Nufft()),
        ("corrected", blurred, Nufft(correction=InverseFilter(SensingSpot(100e-6, "top-hat")))),
    ):
        acquisition = Acquisition(traces, where, dt=DT, sound_speed=SPEED, aperture=6e-3, weights=np.full(300, 1e-8))
        images[name] = reconstruct(acquisition, ImageGrid(180, depth=(1.8e-3, 2.2e-3)), method, compute=CPU)
    point = images["point"].values.max()
    np.testing.assert_allclose(widths(images["corrected"]), widths(images["point"]), rtol=0.1)
    assert images["corrected"].values.max() == pytest.approx(point, rel=0.1)
    assert images["blurred"].values.max() < 0.95 * point


def test_table_of_a_response_with_zeros_has_no_phase_jumps_at_them() -> None:
    spot = SensingSpot(200e-6, "top-hat", ElasticFilm())
    table, steps = tabulate(spot, nyquist=40e6, bandwidth=100.0, sound_speed=SPEED, signed=True)
    frequencies, sines = np.linspace(0, 40e6, table.shape[1]), np.linspace(0, 1, table.shape[2])
    values = table[0] * np.exp(2j * np.pi * table[1])
    np.testing.assert_allclose(values, spot.evaluate(frequencies, sines, SPEED), atol=1e-12)
    loud = np.abs(table[0]) > 0.02
    for axis in (0, 1):
        both = np.take(loud, range(1, loud.shape[axis]), axis) & np.take(loud, range(loud.shape[axis] - 1), axis)
        assert (np.abs(np.diff(table[1], axis=axis))[both] < 0.2).mean() > 0.999
    assert (table[0] < -0.05).any()
    assert steps[0] > 0


@pytest.mark.parametrize(
    ("make", "field", "allowed"),
    [
        (lambda: SensingSpot(-1e-6), "diameter", "at least 1e-07, at most 0.005 (m)"),
        (lambda: SensingSpot(1e-4, "square"), "profile", "gaussian, top-hat"),  # type: ignore[arg-type]
        (lambda: averaged_over_spot(simulate, np.zeros((1, 2)), diameter=1e-4, profile="x"), "profile", "top-hat"),
    ],
)
def test_wrong_spot_is_refused_with_field_and_range(make: Any, field: str, allowed: str) -> None:
    with pytest.raises(InvalidInput) as refused:
        make()
    assert refused.value.field == field
    assert allowed in str(refused.value)
