"""What only a CUDA device can show: the paper's size, memory that really ends, and arrays of CuPy and PyTorch."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from steradian import phantoms, quality
from steradian.imaging import Volume
from steradian.imaging.engines import run_forward, run_inverse
from steradian.imaging.engines.cuda.array_backend import device
from steradian.imaging.engines.cuda.engine import CudaEngine
from steradian.masks import equi_steradian_mask
from support.flat import flat_operator, flat_plan, flat_reconstruct
from support.reference_engine import ReferenceEngine

pytestmark = [pytest.mark.gpu, pytest.mark.timeout(600)]
APERTURE, DEPTH, SPEED, INTERVAL = 13.56e-3, 3.6e-3, 1480.0, 8e-9
MASK = equi_steradian_mask(APERTURE, DEPTH, 1600)
COMMON: dict[str, Any] = {"sampling_interval": INTERVAL, "sound_speed": SPEED}


@pytest.fixture(autouse=True)
def memory() -> Iterator[Any]:
    """Leave none to the next test."""
    backend = device()
    yield backend
    backend.release()


def _traces(samples: int) -> np.ndarray:
    return np.random.default_rng(1).standard_normal((MASK.count, samples), dtype=np.float32)


@pytest.mark.parametrize(("modes", "samples"), [(226, 1024), (452, 1024)])
def test_at_full_size_it_agrees_with_the_processor(modes: int, samples: int) -> None:
    images = []
    for where in ("cpu", "gpu"):
        plan = flat_plan(MASK, samples=samples, modes=modes, device=where, **COMMON)  # type: ignore[arg-type]
        found = plan.run(_traces(samples))
        assert isinstance(found, Volume)
        images.append(found.values)
    here, there = images
    assert there.dtype == np.float32
    assert np.linalg.norm(there - here) <= 1e-5 * np.linalg.norm(here)


def test_at_full_size_it_agrees_with_the_array_engine() -> None:
    """In double precision, on the same tables, computed by CuPy in whole arrays."""
    plan = flat_plan(MASK, samples=1024, modes=226, device="gpu", **COMMON)
    engine = plan.engine
    assert isinstance(engine, CudaEngine)
    expected = run_inverse(ReferenceEngine(plan.tables, xp=engine.backend.xp, dtype="float64"), _traces(1024))
    found = run_inverse(engine, _traces(1024))
    norm = engine.backend.xp.linalg.norm
    assert float(norm(found - expected)) <= 1e-5 * float(norm(expected))


def test_it_is_the_same_bits_every_time_at_full_size() -> None:
    plan = flat_plan(MASK, samples=1024, modes=226, device="gpu", **COMMON)
    first, again = (plan.run(_traces(1024)) for _ in range(2))
    assert isinstance(first, Volume)
    assert isinstance(again, Volume)
    np.testing.assert_array_equal(first.values, again.values)


def test_the_model_s_adjoint_is_one_at_full_size() -> None:
    model = flat_operator(MASK, samples=512, modes=226, lateral_padding=1.2, device="gpu", dtype="float64", **COMMON)
    engine = model.engine
    assert isinstance(engine, CudaEngine)
    rng = engine.backend.xp.random.default_rng(2)
    volume, traces = rng.standard_normal(model.volume_shape), rng.standard_normal(model.trace_shape)
    forward, backward = run_forward(engine, volume), run_inverse(engine, traces)
    norm, dot = engine.backend.xp.linalg.norm, engine.backend.xp.vdot
    apart = abs(float(dot(forward, traces)) - float(dot(volume, backward)))
    assert apart <= 1e-12 * float(norm(forward)) * float(norm(traces))


def test_a_volume_larger_than_the_memory_allowed_goes_in_pieces() -> None:
    images = []
    for limit in (None, 150_000_000):
        plan = flat_plan(MASK, samples=1024, modes=226, device="gpu", device_memory=limit, **COMMON)
        assert plan.engine.room.fits_in_one_pass == (limit is None)  # type: ignore[union-attr]
        found = plan.run(_traces(1024))
        assert isinstance(found, Volume)
        images.append(found.values)
    assert np.linalg.norm(images[1] - images[0]) <= 1e-6 * np.linalg.norm(images[0])


def test_a_full_device_goes_back_to_pieces(memory: Any) -> None:
    pool = memory.xp.get_default_memory_pool()
    plan = flat_plan(MASK, samples=1024, modes=226, device="auto", **COMMON)
    assert plan.engine.room.fits_in_one_pass  # type: ignore[union-attr]
    expected = plan.run(_traces(1024))
    memory.release()
    pool.set_limit(size=pool.used_bytes() + 900_000_000)
    try:
        found = plan.run(_traces(1024))
    finally:
        pool.set_limit(size=0)
    assert isinstance(found, Volume)
    assert isinstance(expected, Volume)
    assert "the GPU's memory was full" in plan.chosen.notes[0]
    assert np.linalg.norm(found.values - expected.values) <= 1e-5 * np.linalg.norm(expected.values)


def test_arrays_of_the_device_stay_there(memory: Any) -> None:
    xp, traces = memory.xp, _traces(256)
    plan = flat_plan(MASK, samples=256, modes=64, device="gpu", **COMMON)
    expected = plan.run(traces)
    found: Any = plan.run(xp.asarray(traces))
    assert isinstance(expected, Volume)
    assert isinstance(found.values, xp.ndarray)
    np.testing.assert_array_equal(found.values.get(), expected.values)
    model = flat_operator(MASK, samples=256, modes=64, lateral_padding=1.0, device="gpu", **COMMON)
    assert isinstance(model.forward(xp.zeros(model.volume_shape, np.float32)), xp.ndarray)
    integers: Any = plan.run(xp.asarray((1000 * traces).astype(np.int16)), scale=1e-3)
    assert np.linalg.norm(integers.values.get() - expected.values) <= 1e-2 * np.linalg.norm(expected.values)


def test_tensors_of_pytorch_come_by_dlpack(memory: Any) -> None:
    torch = importlib.import_module("torch")
    traces = _traces(256)
    plan = flat_plan(MASK, samples=256, modes=64, device="gpu", **COMMON)
    expected = plan.run(traces)
    assert isinstance(expected, Volume)
    for where in ("cuda", "cpu"):
        found: Any = plan.run(torch.from_numpy(traces).to(where))
        back = torch.from_dlpack(found.values)
        assert back.device.type == where
        np.testing.assert_array_equal(back.cpu().numpy(), expected.values)


def test_the_fit_is_as_good_as_the_processor_s() -> None:
    balls = phantoms.yarn(0, centre=(0.0, 0.0, DEPTH), radius=3e-3)
    clean = phantoms.pressure(balls, MASK.positions, samples=1024, sampling_interval=INTERVAL, sound_speed=SPEED)
    traces = phantoms.add_noise(clean, 30.0, convention="peak", seed=0)
    found = []
    for where in ("cpu", "gpu"):
        volume = flat_reconstruct(
            traces, MASK.positions, aperture=APERTURE, modes=226, method="iterative", depth_range=(1.2e-3, 6e-3),
            device=where, **COMMON,  # type: ignore[arg-type]
        )  # fmt: skip
        axes = volume.axes
        assert axes.y is not None
        truth = phantoms.initial_pressure(balls, axes.x, axes.y, axes.z)
        found.append(quality.correlation(volume.values, truth))
    assert found[0] > 0.9
    assert abs(found[1] - found[0]) < 2e-3
