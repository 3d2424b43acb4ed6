"""Layered media: objects below boundaries are imaged at their depth, width and amplitude.

A-lines are simulated by rays (Fermat's principle), which the reconstruction does not know.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from steradian.core.exceptions import InvalidInput
from steradian.imaging import (
    Acquisition,
    AcquisitionGeometry,
    Compute,
    ImageGrid,
    Layer,
    LinearKappa,
    Medium,
    Nufft,
    ReconstructionPlan,
    Volume,
    reconstruct,
)
from steradian.imaging.engines import run_inverse
from steradian.masks import equi_steradian_mask
from steradian.phantoms import Balls, layered_pressure, pressure
from support.reference_engine import ReferenceEngine

WATER_TISSUE = Medium([Layer(1480.0, 2e-3), Layer(1580.0)])
SLOWER_BELOW = Medium([Layer(1580.0, 2e-3), Layer(1480.0)])
TISSUE = Medium([Layer(1580.0)])
DT, SAMPLES, SIZE = 25e-9, 200, 90e-6
CENTRES = np.array([(0.4e-3, 0.3e-3, 1.2e-3), (-0.5e-3, 0.2e-3, 3.0e-3), (0.2e-3, -0.6e-3, 4.4e-3)])
BALLS = Balls(CENTRES, np.full(3, SIZE), np.ones(3))
MASK = equi_steradian_mask(8e-3, 4e-3, 400)
GRID = ImageGrid(modes=108, depth=(0.6e-3, 5.2e-3), lateral_padding=1.25)
CPU = Compute(device="cpu")


def simulate(medium: Medium, samples: int = SAMPLES, time_zero: float = 0.0) -> np.ndarray:
    return layered_pressure(BALLS, MASK.positions, medium, samples=samples, sampling_interval=DT, time_zero=time_zero)


@lru_cache
def image(medium: Medium, imaged_as: Medium | None = None) -> Volume:
    return reconstruct(Acquisition(simulate(medium), MASK, dt=DT, medium=imaged_as or medium), GRID, compute=CPU)


def ball_image(volume: Volume, centre: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """Place of the largest voxel near a ball (parabola through its neighbours), its value, and widths at half of it."""
    axes = [volume.coordinates(name) for name in volume.names]
    at = [int(np.abs(axis - c).argmin()) for axis, c in zip(axes, centre, strict=True)]
    reach = 6
    near = volume.values[tuple(slice(i - reach, i + reach + 1) for i in at)]
    top = np.array(np.unravel_index(near.argmax(), near.shape)) + np.array(at) - reach
    place, widths = [], []
    for axis, (i, step) in enumerate(zip(top, volume.spacing, strict=True)):
        line = np.moveaxis(volume.values, axis, 0)[(slice(None), *np.delete(top, axis))].astype(float)
        before, here, after = line[i - 1 : i + 2]
        place.append(axes[axis][i] + step * 0.5 * (before - after) / (before - 2 * here + after))
        low = i - next(n for n in range(20) if line[i - n] < here / 2)
        high = i + next(n for n in range(20) if line[i + n] < here / 2)
        left = low + (here / 2 - line[low]) / (line[low + 1] - line[low])
        right = high - (here / 2 - line[high]) / (line[high - 1] - line[high])
        widths.append((right - left) * step)
    return np.array(place), float(volume.values[tuple(top)]), np.array(widths)


def test_ray_simulation_is_the_closed_form_in_one_medium() -> None:
    found = layered_pressure(BALLS, MASK.positions, TISSUE, samples=SAMPLES, sampling_interval=DT)
    expected = pressure(BALLS, MASK.positions, samples=SAMPLES, sampling_interval=DT, sound_speed=1580.0)
    np.testing.assert_allclose(found, expected, atol=2e-6 * np.abs(expected).max())


@pytest.mark.long
def test_equal_speeds_give_the_image_of_one_medium() -> None:
    traces = np.random.default_rng(0).standard_normal((MASK.count, SAMPLES))
    layers = Medium([Layer(1500.0, 1e-3), Layer(1500.0, 0.77e-3), Layer(1500.0)])
    one, many = (
        reconstruct(
            Acquisition(traces, MASK, dt=DT, medium=medium),
            ImageGrid(modes=24, depth=(0.5e-3, 5e-3), time_padding=1.7),
            Nufft(tolerance=1e-8),
            compute=CPU,
        )
        for medium in (Medium([Layer(1500.0)]), layers)
    )
    assert many.spacing == pytest.approx(one.spacing)
    np.testing.assert_allclose(many.axes.z, one.axes.z)
    # the periods along the depth differ, and with them what the noise of the record's end folds onto
    assert np.linalg.norm(many.values - one.values) <= 2e-2 * np.linalg.norm(one.values)


@pytest.mark.parametrize(
    "medium",
    [WATER_TISSUE, SLOWER_BELOW, Medium([Layer(1480.0, 1e-3), Layer(1530.0, 1e-3), Layer(1580.0)])],
    ids=["faster below", "slower below", "three layers"],
)  # fmt: skip
def test_layered_image_shows_each_ball_at_its_place_as_wide_as_in_one_medium(medium: Medium) -> None:
    layered, plain = image(medium), image(TISSUE)
    for centre in CENTRES:
        place, value, widths = ball_image(layered, centre)
        _, same, usual = ball_image(plain, centre)
        np.testing.assert_array_less(np.abs(place - centre), 0.5 * np.array(layered.spacing))
        np.testing.assert_allclose(widths, usual, rtol=0.1)
        assert value == pytest.approx(same, rel=0.2)  # the speed changes the angles that the aperture covers


def test_one_speed_displaces_what_layers_show_in_place() -> None:
    place, _, _ = ball_image(image(WATER_TISSUE, Medium([Layer(1530.0)])), CENTRES[1])
    assert abs(place[2] - CENTRES[1, 2]) > 40e-6


def test_densities_restore_amplitudes_that_transmission_takes() -> None:
    heavy = Medium([Layer(1480.0, 2e-3, 1000.0), Layer(1580.0, None, 1900.0)])
    restored, taken, plain = image(heavy), image(heavy, WATER_TISSUE), image(WATER_TISSUE)
    expected = ball_image(plain, CENTRES[1])[1]
    assert ball_image(restored, CENTRES[1])[1] == pytest.approx(expected, rel=0.02)
    transmitted = 2 * 1480 * 1000 / (1480 * 1000 + 1580 * 1900)
    assert ball_image(taken, CENTRES[1])[1] == pytest.approx(transmitted * expected, rel=0.05)


def test_late_record_through_layers_shows_the_ball_in_place() -> None:
    late = 80
    traces = simulate(WATER_TISSUE, samples=120, time_zero=late * DT)
    acquisition = Acquisition(traces, MASK, dt=DT, t0=late * DT, medium=WATER_TISSUE)
    volume = reconstruct(acquisition, GRID, compute=CPU)
    place, value, _ = ball_image(volume, CENTRES[2])
    np.testing.assert_array_less(np.abs(place - CENTRES[2]), 0.5 * np.array(volume.spacing))
    assert value == pytest.approx(ball_image(image(WATER_TISSUE), CENTRES[2])[1], rel=0.05)
    whole = reconstruct(acquisition, ImageGrid(modes=16), compute=CPU)
    assert whole.axes.z[0] == pytest.approx(2e-3 + 1580 * (late * DT - 2e-3 / 1480), abs=whole.spacing[2])
    assert whole.axes.z[-1] == pytest.approx(2e-3 + 1580 * (200 * DT - 2e-3 / 1480), abs=whole.spacing[2])


def test_layered_image_states_which_angles_are_not_heard() -> None:
    notes = image(SLOWER_BELOW).info.notes
    assert any("beyond 70° to the normal" in note for note in notes)
    assert not image(WATER_TISSUE).info.notes


def test_layers_outside_the_depth_range_cost_nothing() -> None:
    geometry = AcquisitionGeometry(MASK, SAMPLES, dt=DT, medium=WATER_TISSUE)
    plan = ReconstructionPlan(geometry, ImageGrid(modes=16, depth=(2.1e-3, 4e-3)), compute=CPU)
    assert len(plan.layers) == 1
    assert plan.geometry.axes().z[0] >= 2e-3


def test_layered_plan_names_the_layer_in_its_progress() -> None:
    stages: set[str] = set()
    _plan().run(np.zeros((MASK.count, SAMPLES)), progress=lambda stage, done, total: stages.add(stage))
    assert {"layer 1 of 2: image", "layer 2 of 2: image"} <= stages


@pytest.mark.parametrize("line", [False, True], ids=["plane", "line"])
def test_engines_agree_on_the_image_of_each_layer(line: bool, cuda: Callable[..., Any]) -> None:
    rng = np.random.default_rng(0)
    sensors = rng.uniform(-0.5e-3, 0.5e-3, 9 if line else (9, 2))
    medium = Medium([Layer(1580.0, 0.1e-3, 900.0), Layer(1480.0, 0.1e-3, 1000.0), Layer(1540.0, None, 1100.0)])
    geometry = AcquisitionGeometry(sensors, 24, dt=15e-9, medium=medium, aperture=1e-3)
    plan = ReconstructionPlan(
        geometry, ImageGrid(modes=6), Nufft(tolerance=1e-2), compute=Compute(device="cpu", dtype="float64")
    )
    assert len(plan.layers) == 3
    traces = rng.standard_normal((9, 24))
    for layer in plan.layers:
        expected = run_inverse(ReferenceEngine(layer.tables), traces)
        on_gpu = cuda(layer.tables)
        for found in (run_inverse(layer.chosen.engine, traces), on_gpu.host(run_inverse(on_gpu, traces))):
            assert np.linalg.norm(found - expected) <= 1e-12 * np.linalg.norm(expected)


@pytest.mark.parametrize(
    ("make", "field", "allowed"),
    [
        (lambda: Layer(1480.0, -1e-3), "thickness", "at most 1"),
        (lambda: Layer(1.48, 1e-3), "sound_speed", "at least 300"),
        (lambda: Layer(1480.0, 1e-3, 1.0), "density", "at least 100"),
        (lambda: Medium([Layer(1480.0), Layer(1580.0)]), "thickness", "at most 1"),
        (lambda: Medium([Layer(1480.0, 1e-3), Layer(1580.0, 1e-3)]), "thickness", "none for the last layer"),
        (lambda: Medium([Layer(1480.0, 1e-3, 1000.0), Layer(1580.0)]), "density", "for all layers, or for none"),
        (lambda: Medium([]), "layers", "1 to 16"),
        (lambda: Medium([1480.0]), "layers", "Layer"),
        (lambda: _geometry(sound_speed=1500.0, medium=WATER_TISSUE), "sound_speed", "none beside a medium"),
        (lambda: _geometry(medium=1500.0), "medium", "a Medium"),
        (lambda: _geometry(), "sound_speed", "at least 300"),
        (lambda: _plan(depth=(1e-3, 9e-3)), "depth", "m"),
        (lambda: _plan(LinearKappa()), "method", "ner or nedner"),
    ],
)  # fmt: skip
def test_wrong_medium_is_refused_with_field_and_range(make: Any, field: str, allowed: str) -> None:
    with pytest.raises(InvalidInput) as refused:
        make()
    assert refused.value.field == field
    assert allowed in str(refused.value)


def _geometry(**options: Any) -> AcquisitionGeometry:
    return AcquisitionGeometry(MASK, SAMPLES, dt=DT, **options)


def _plan(*method: Any, depth: Any = None) -> ReconstructionPlan:
    return ReconstructionPlan(_geometry(medium=WATER_TISSUE), ImageGrid(modes=16, depth=depth), *method, compute=CPU)
