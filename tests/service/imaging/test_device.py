"""Who computes: ``device`` of a reconstruction, what is said where there is no GPU, what is done when it is full."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from steradian.core.exceptions import InvalidInput
from steradian.imaging import Iterative
from steradian.imaging.engines.cuda import array_backend
from support.flat import flat_operator, flat_plan, flat_reconstruct
from support.remote import Remote

SIDE = 1e-3
RNG = np.random.default_rng(7)
POSITIONS = (RNG.random((9, 2)) - 0.5) * SIDE
TRACES = RNG.standard_normal((9, 18))
COMMON: dict[str, Any] = {
    "aperture": SIDE, "modes": (6, 5), "sampling_interval": 8e-9, "sound_speed": 1500.0, "dtype": "float64",
}  # fmt: skip
without_gpu = pytest.mark.skipif(array_backend.unavailable_reason() is None, reason="there is a GPU")


@pytest.fixture
def simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    """A GPU for who asks for one: where there is none, Numba's simulator."""
    if array_backend.unavailable_reason():
        monkeypatch.setenv(array_backend.USE_SIMULATOR, "simulator")


@without_gpu
def test_gpu_device_without_gpu_is_refused_with_reason() -> None:
    with pytest.raises(InvalidInput, match=r"device is gpu; allowed: cpu or auto here \(.*(not installed|no CUDA)"):
        flat_plan(POSITIONS, samples=18, device="gpu", **COMMON)


@without_gpu
def test_auto_is_the_processor_where_there_is_no_gpu() -> None:
    plan = flat_plan(POSITIONS, samples=18, device="auto", **COMMON)
    assert (plan.chosen.device, plan.chosen.notes) == ("cpu", [])


@pytest.mark.long
def test_the_extra_is_not_imported_by_the_processor() -> None:
    code = (
        "import sys, numpy as np; from steradian import Acquisition, Compute, ImageGrid, reconstruct; "
        "recorded = {'dt': 8e-9, 'sound_speed': 1500.0, 'aperture': 1e-3, 'weights': np.full(2, 1e-7)}; "
        "acquisition = Acquisition(np.ones((2, 16)), np.zeros((2, 2)), **recorded); "
        "reconstruct(acquisition, ImageGrid(4), compute=Compute(device='cpu')); "
        "assert not {'cupy', 'numba.cuda', 'numba_cuda'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_invalid_device_or_traces_are_refused() -> None:
    with pytest.raises(InvalidInput, match="device is tpu; allowed: auto, cpu, gpu"):
        flat_plan(POSITIONS, samples=18, device="tpu", **COMMON)  # type: ignore[arg-type]
    with pytest.raises(InvalidInput, match="an array in memory, or the device gpu"):
        flat_plan(POSITIONS, samples=18, **COMMON).run(Remote(TRACES))  # type: ignore[arg-type]


@pytest.mark.usefixtures("simulated")
@pytest.mark.parametrize("device", ["auto", "gpu"])
def test_the_gpu_makes_the_processor_s_image(device: Any) -> None:
    expected = flat_reconstruct(TRACES, POSITIONS, **COMMON)
    plan = flat_plan(POSITIONS, samples=18, device=device, **COMMON)
    assert plan.chosen.device != "cpu"
    found: Any = plan.run(TRACES)
    assert isinstance(found.values, np.ndarray)
    assert np.linalg.norm(found.values - expected.values) <= 1e-9 * np.linalg.norm(expected.values)
    several: Any = plan.run(np.stack([TRACES, 2 * TRACES]).astype(np.float32), scale=3.0)
    assert np.linalg.norm(several[1].values - 6 * expected.values) <= 1e-6 * np.linalg.norm(several[1].values)


@pytest.mark.usefixtures("simulated")
def test_the_gpu_s_model_is_the_processor_s() -> None:
    here, there = (flat_operator(POSITIONS, samples=12, device=device, **COMMON) for device in ("cpu", "gpu"))  # type: ignore[arg-type]
    volume = RNG.standard_normal(here.volume_shape)
    expected = here.forward(volume)
    assert np.linalg.norm(there.forward(volume) - expected) <= 1e-9 * np.linalg.norm(expected)
    there_and_back = there.T @ (there @ volume.ravel())
    assert np.linalg.norm(there_and_back - here.T @ (here @ volume.ravel())) <= 1e-9 * np.linalg.norm(there_and_back)


@pytest.mark.usefixtures("simulated")
def test_gpu_iterative_fit_matches_cpu() -> None:
    options = Iterative(iterations=1, refits=1, discrepancy=None, highest_frequency=2e7)
    here, there = (
        flat_reconstruct(
            TRACES, POSITIONS, method="iterative", iterative=options, lateral_padding=1.0, device=device, **COMMON
        ).values
        for device in ("cpu", "gpu")
    )
    assert np.linalg.norm(there - here) <= 1e-6 * np.linalg.norm(here)


@pytest.mark.usefixtures("simulated")
def test_the_gpu_s_memory_may_be_limited() -> None:
    expected = flat_reconstruct(TRACES, POSITIONS, **COMMON)
    with pytest.raises(InvalidInput, match=r"device_memory is 1000; allowed: at least \d+ bytes for an image of 6 × 5"):
        flat_reconstruct(TRACES, POSITIONS, device="gpu", device_memory=1000, **COMMON)
    plan = flat_plan(POSITIONS, samples=18, device="auto", device_memory=1000, **COMMON)
    assert plan.chosen.device == "cpu"
    assert "the GPU's memory being too small" in plan.chosen.notes[0]
    found: Any = plan.run(TRACES)
    np.testing.assert_array_equal(found.values, expected.values)


@pytest.mark.usefixtures("simulated")
@pytest.mark.parametrize(("failures", "device"), [(1, "the GPU"), (9, "cpu")])
def test_a_full_gpu_goes_back_to_pieces_and_to_the_processor(
    failures: int, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = flat_plan(POSITIONS, samples=18, device="auto", **COMMON)
    kind = type(plan.engine.backend)  # type: ignore[union-attr]
    launch, left = kind.launch, iter(range(failures))

    def full_at_first(*given: Any) -> None:
        if next(left, None) is not None:
            raise MemoryError
        launch(*given)

    monkeypatch.setattr(kind, "launch", full_at_first)
    monkeypatch.setattr(kind, "is_out_of_memory", lambda _, error: isinstance(error, MemoryError))
    found: Any = plan.run(TRACES)
    expected = flat_reconstruct(TRACES, POSITIONS, **COMMON).values
    assert np.linalg.norm(found.values - expected) <= 1e-9 * np.linalg.norm(expected)
    assert "the GPU's memory was full" in plan.chosen.notes[0]
    assert (plan.chosen.device == "cpu") == (device == "cpu")
