"""Forward model of layered media: A-lines as by rays, exact adjoint, and what is built on them.

A-lines are simulated by rays (Fermat's principle), which the model does not know.
"""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest

from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.imaging import (
    Acquisition,
    AcquisitionGeometry,
    Compute,
    ImageGrid,
    Iterative,
    Layer,
    Medium,
    ReconstructionPlan,
    reconstruct,
)
from steradian.imaging.incremental import IncrementalReconstruction
from steradian.imaging.operators import ForwardOperator
from steradian.masks import equi_steradian_mask
from steradian.phantoms import Balls, initial_pressure, layered_pressure

DT, SAMPLES = 25e-9, 200
MASK = equi_steradian_mask(8e-3, 4e-3, 200)
DEPTH = (0.3e-3, 5.2e-3)
FASTER_BELOW = Medium([Layer(1480.0, 2e-3, 1000.0), Layer(1580.0, None, 1000.0)])
SLOWER_BELOW = Medium([Layer(1580.0, 2e-3, 1000.0), Layer(1480.0, None, 1000.0)])
HEAVIER_BELOW = Medium([Layer(1480.0, 2e-3, 1000.0), Layer(1580.0, None, 1900.0)])
THREE = Medium([Layer(1480.0, 1.9e-3, 1000.0), Layer(1540.0, 1.83e-3, 1050.0), Layer(1620.0, None, 1100.0)])
CENTRES = np.array([(0.4e-3, 0.3e-3, 1.2e-3), (-0.5e-3, 0.2e-3, 3.0e-3), (0.2e-3, -0.6e-3, 4.4e-3)])


def model(
    medium: Medium, *, samples: int = SAMPLES, t0: float = 0.0, modes: int = 80, **options: Any
) -> ForwardOperator:
    geometry = AcquisitionGeometry(MASK, samples, dt=DT, medium=medium, t0=t0)
    options.setdefault("compute", Compute(device="cpu"))
    return ForwardOperator(geometry, ImageGrid(modes=modes, depth=DEPTH), **options)


def ball(centre: np.ndarray, size: float = 120e-6) -> Balls:
    return Balls(centre[None], np.array([size]), np.ones(1))


def volume(operator: ForwardOperator, balls: Balls) -> np.ndarray:
    axes = operator.geometry.axes()
    assert axes.y is not None
    return initial_pressure(balls, axes.x, axes.y, axes.z)


@pytest.mark.long
@pytest.mark.parametrize("late", [0, 55.3], ids=["from the pulse", "late"])
@pytest.mark.parametrize(
    "medium",
    [FASTER_BELOW, SLOWER_BELOW, HEAVIER_BELOW, THREE],
    ids=["faster below", "slower below", "heavier below", "three layers"],
)
def test_model_of_layers_gives_the_a_lines_of_rays(medium: Medium, late: float) -> None:
    t0, samples = late * DT, SAMPLES - int(late)
    operator = model(medium, samples=samples, t0=t0)
    for centre in CENTRES:
        found = operator.forward(volume(operator, ball(centre)))
        truth = layered_pressure(
            ball(centre), MASK.positions, medium, samples=samples, sampling_interval=DT, time_zero=t0
        )
        assert np.linalg.norm(found - truth) <= 0.006 * np.linalg.norm(truth)


@pytest.mark.long
@pytest.mark.parametrize(
    ("thickness", "most"), [(2.03e-3, 4e-4), (1.13e-3, 0.05)], ids=["between balls", "through a ball"]
)
def test_layers_of_equal_speed_are_the_model_of_one_medium(thickness: float, most: float) -> None:
    options: dict[str, Any] = {"tolerance": 1e-7, "compute": Compute(device="cpu", dtype="float64")}
    one = model(Medium([Layer(1500.0)]), **options)
    many = model(Medium([Layer(1500.0, thickness), Layer(1500.0, 1.67e-3), Layer(1500.0)]), **options)
    balls = Balls(CENTRES, np.full(3, 120e-6), np.ones(3))
    expected = one.forward(volume(one, balls))
    assert np.linalg.norm(many.forward(volume(many, balls)) - expected) <= most * np.linalg.norm(expected)


@pytest.mark.long
def test_without_densities_layers_are_equally_dense() -> None:
    layers = [Layer(1480.0, 2e-3), Layer(1580.0)]
    plain, dense = model(Medium(layers), modes=16), model(FASTER_BELOW, modes=16)
    given = np.random.default_rng(0).standard_normal(plain.volume_shape)
    np.testing.assert_array_equal(plain.forward(given), dense.forward(given))


class Slanted:
    """A response with a loss and a delay that grow with frequency and angle."""

    def evaluate(self, frequencies: np.ndarray, sines: np.ndarray, sound_speed: float) -> np.ndarray:
        f, s = frequencies[:, None], sines[None, :]
        return (1 - 0.5 * s**2) / (1 + 1j * f / 3e6) * np.exp(-2j * np.pi * f * 2e-8 * s)


@pytest.mark.parametrize(("dtype", "most"), [("float32", 1e-6), ("float64", 1e-14)])
@pytest.mark.parametrize("sensors", ["scattered", "grid", "line"])
@pytest.mark.parametrize("t0", [0.0, 13.4 * DT, -7.3 * DT], ids=["from the pulse", "late", "early"])
def test_both_products_of_layers_agree_to_rounding(dtype: str, most: float, sensors: str, t0: float) -> None:
    rng = np.random.default_rng(0)
    where: np.ndarray = rng.uniform(-1e-3, 1e-3, 25 if sensors == "line" else (25, 2))
    if sensors == "grid":
        where = np.stack(np.meshgrid(*2 * [np.arange(-4, 4) * 0.25e-3], indexing="ij"), axis=-1).reshape(-1, 2)
    medium = Medium([Layer(1580.0, 0.4e-3, 900.0), Layer(1480.0, 0.31e-3, 1000.0), Layer(1540.0, None, 1100.0)])
    geometry = AcquisitionGeometry(where, 60, dt=DT, medium=medium, t0=t0, aperture=2e-3)
    compute = Compute(device="cpu", dtype=dtype, threads=2)
    operator = ForwardOperator(
        geometry, ImageGrid(8, depth=(0.2e-3, 1.6e-3)), response=Slanted(), max_frequency=15e6, compute=compute
    )
    volume, traces = rng.standard_normal(operator.volume_shape), rng.standard_normal(operator.trace_shape)
    there, back = (each.astype(np.float64) for each in (operator.forward(volume), operator.backward(traces)))
    assert np.linalg.norm(there) > 0
    assert abs(np.vdot(there, traces) - np.vdot(volume, back)) <= most * np.linalg.norm(there) * np.linalg.norm(traces)


def test_product_through_layers_takes_no_more_memory_than_stated() -> None:
    operator = model(FASTER_BELOW, modes=48, compute=Compute(device="cpu", threads=2))
    given, traces = (np.ones(shape, np.float32) for shape in (operator.volume_shape, operator.trace_shape))
    peaks = []
    for product, values in ((operator.forward, given), (operator.backward, traces)):
        product(values)
        tracemalloc.start()
        product(values)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert 0.4 * operator.memory_bytes < max(peaks) <= operator.memory_bytes + 2**20


def test_products_with_kept_factors_equal_those_whose_factors_are_made_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = model(THREE, modes=20)
    monkeypatch.setattr("steradian.imaging.engines.numba.layered._KEPT_BYTES", 0)
    anew = model(THREE, modes=20)
    random = np.random.default_rng(0)
    given, traces = (random.standard_normal(shape) for shape in (kept.volume_shape, kept.trace_shape))
    for _ in range(2):
        np.testing.assert_array_equal(kept.forward(given), anew.forward(given))
        np.testing.assert_array_equal(kept.backward(traces), anew.backward(traces))
    assert kept.memory_bytes > anew.memory_bytes


def test_product_through_layers_names_the_layer_and_is_cancelled() -> None:
    operator, stages = model(FASTER_BELOW, modes=16), set()
    operator.forward(np.zeros(operator.volume_shape), progress=lambda stage, done, total: stages.add(stage))
    assert {"layer 1 of 2: depth to time", "layer 2 of 2: layers above"} <= stages
    with pytest.raises(Cancelled):
        operator.backward(np.zeros(operator.trace_shape), cancelled=lambda: True)


@pytest.mark.long
@pytest.mark.parametrize("medium", [FASTER_BELOW, SLOWER_BELOW], ids=["faster below", "slower below"])
def test_iterative_image_through_layers_shows_each_ball_at_its_place_and_as_wide_as_in_one_medium(
    medium: Medium,
) -> None:
    balls = Balls(CENTRES, np.full(3, 90e-6), np.ones(3))
    plain = Medium([Layer(1580.0)])
    grid = ImageGrid(modes=108, depth=(0.6e-3, 5.2e-3))
    images = {}
    for each in (medium, plain):
        traces = layered_pressure(balls, MASK.positions, each, samples=SAMPLES, sampling_interval=DT)
        acquisition = Acquisition(traces, MASK, dt=DT, medium=each)
        images[each] = reconstruct(acquisition, grid, Iterative(), compute=Compute(device="cpu"))
    for centre in CENTRES:
        (place, widths), (_, usual) = (_measured(images[each], centre) for each in (medium, plain))
        np.testing.assert_array_less(np.abs(place - centre), 0.5 * np.array(images[medium].spacing))
        np.testing.assert_allclose(widths, usual, rtol=0.1)


def _measured(volume: Any, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return centre of gravity and widths (standard deviations) of what is above half of a ball's largest value."""
    axes = [volume.coordinates(name) for name in volume.names]
    at = [int(np.abs(axis - c).argmin()) for axis, c in zip(axes, centre, strict=True)]
    some = tuple(slice(i - 6, i + 7) for i in at)
    near = np.maximum(volume.values[some] - 0.5 * volume.values[some].max(), 0).astype(float)
    points = np.meshgrid(*(axis[part] for axis, part in zip(axes, some, strict=True)), indexing="ij")
    means = np.array([np.average(each, weights=near) for each in points])
    widths = [np.sqrt(np.average((p - m) ** 2, weights=near)) for p, m in zip(points, means, strict=True)]
    return means, np.array(widths)


def test_image_that_grows_through_layers_becomes_the_plan_s() -> None:
    geometry = AcquisitionGeometry(MASK, SAMPLES, dt=DT, medium=THREE)
    plan = ReconstructionPlan(geometry, ImageGrid(modes=24), compute=Compute(device="cpu"))
    traces = np.random.default_rng(0).standard_normal((MASK.count, SAMPLES)).astype(np.float32)
    order = np.random.default_rng(1).permutation(MASK.count)
    growing = IncrementalReconstruction(plan)
    for some in (order[:70], order[70:]):
        growing.add(some, traces[some])
        found = growing.volume()
    expected = plan.run(traces)
    assert np.linalg.norm(found.values - expected.values) <= 1e-5 * np.linalg.norm(expected.values)


def test_model_of_layers_refuses_a_gpu_and_depths_beyond_the_record() -> None:
    with pytest.raises(InvalidInput, match="device is gpu; allowed: cpu or auto"):
        model(FASTER_BELOW, modes=16, compute=Compute(device="gpu"))
    geometry = AcquisitionGeometry(MASK, SAMPLES, dt=DT, medium=FASTER_BELOW)
    with pytest.raises(InvalidInput, match=r"depth is .*allowed: two depths .* within 0 … 0.0077"):
        ForwardOperator(geometry, ImageGrid(16, depth=(1e-3, 9e-3)))
