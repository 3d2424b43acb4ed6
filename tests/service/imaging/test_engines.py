"""The compiled engine computes what the array engine says in whole arrays, also at the size that the paper has."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from steradian.core.exceptions import Cancelled
from steradian.imaging import ElasticFilm, InverseFilter, kaiser_bessel
from steradian.imaging.engines import ProgressMonitor, run_forward, run_inverse
from steradian.imaging.engines.numba.constants import CACHE_LINE_BYTES
from steradian.imaging.engines.numba.engine import NumbaEngine
from steradian.imaging.engines.numba.memory_plan import aligned_empty
from steradian.masks import equi_steradian_mask
from support.flat import flat_operator, flat_plan
from support.reference_engine import ReferenceEngine

SIDE = 0.01
RNG = np.random.default_rng(0)
ANYWHERE = (RNG.random((60, 2)) - 0.5) * SIDE
COMMON: dict[str, Any] = {"sampling_interval": 8e-9, "sound_speed": 1500.0, "tolerance": 1e-8}


def _grid(count: int, displaced: float = 0.0) -> np.ndarray:
    axis = (np.arange(count) - count // 2 + displaced) * SIDE / count
    return np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)


SETTINGS: dict[str, tuple[np.ndarray, dict[str, Any]]] = {
    "anywhere": (ANYWHERE, {"modes": 24}),
    "rows on lines of the cache": (ANYWHERE, {"modes": 24, "samples": 96}),
    "rows that are filled up": (ANYWHERE, {"modes": 24, "samples": 123, "depth_range": (0, 1.05e-3)}),
    "odd": (ANYWHERE, {"modes": (23, 17), "samples": 100}),
    "padded": (
        ANYWHERE,
        {
            "modes": (24, 18), "aperture": (SIDE, 1.5 * SIDE), "time_padding": 1.5, "lateral_padding": 1.4,
            "time_zero": 3.3e-8,
        },
    ),
    "grid, upsampled, some depths": (_grid(24), {"modes": 24, "upsampling": 2, "depth_range": (1e-4, 6e-4)}),
    "coarser grid": (_grid(12), {"modes": 24}),
    "coarser grid, displaced": (_grid(12, 0.25), {"modes": 24}),
    "displaced grid": (_grid(24, 0.25), {"modes": 24}),
    "line": ((RNG.random(50) - 0.5) * SIDE, {"modes": 64}),
    "linear": (ANYWHERE, {"modes": 24, "method": "linear"}),
    "nearest": (_grid(24), {"modes": 24, "method": "nearest"}),
    "interpolated": (ANYWHERE, {"modes": 24, "method": "interpolated"}),
    "filtered": (ANYWHERE, {"modes": 24, "correction": InverseFilter(ElasticFilm())}),
    "the paper's window": (ANYWHERE, {"modes": 24, "window": kaiser_bessel(6, 2.0)}),
}  # fmt: skip


@pytest.mark.parametrize("setting", SETTINGS)
def test_both_engines_make_the_same_image(setting: str) -> None:
    positions, options = SETTINGS[setting]
    plan = flat_plan(positions, **{"samples": 101, "aperture": SIDE, **COMMON, **options})
    traces = RNG.standard_normal((len(positions), plan.geometry.samples))
    expected = run_inverse(ReferenceEngine(plan.tables), traces)
    found = plan.run(traces).values  # type: ignore[union-attr]
    assert np.linalg.norm(found - expected) <= 1e-9 * np.linalg.norm(expected)


@pytest.mark.long
@pytest.mark.parametrize("setting", ["anywhere", "rows that are filled up", "odd", "grid", "line"])
def test_both_engines_make_the_same_a_lines_and_their_transpose(setting: str) -> None:
    positions, options = (_grid(24), {"modes": 24}) if setting == "grid" else SETTINGS[setting]
    model = flat_operator(
        positions,
        response=ElasticFilm(),
        **{"samples": 64, "aperture": SIDE, "depth_range": (1e-4, 7e-4), **COMMON, **options},
    )
    engine = ReferenceEngine(model.tables)
    volume, traces = RNG.standard_normal(model.volume_shape), RNG.standard_normal(model.trace_shape)
    for found, expected in (
        (model.forward(volume), run_forward(engine, volume)),
        (model.backward(traces), run_inverse(engine, traces)),
    ):
        assert np.linalg.norm(found - expected) <= 1e-11 * np.linalg.norm(expected)


def test_lateral_accumulates_sensor_subsets() -> None:
    plan = flat_plan(ANYWHERE, samples=101, aperture=SIDE, modes=24, **COMMON)
    traces = RNG.standard_normal((60, 101))
    for engine in (plan.engine, ReferenceEngine(plan.tables)):
        both = engine.lateral(
            traces[40:], sensors=np.arange(40, 60), onto=engine.lateral(traces[:40], sensors=np.arange(40))
        )
        kept = engine.to_image(engine.to_depth(both, kept=True))
        again = engine.to_image(engine.to_depth(both))
        np.testing.assert_array_equal(kept, again)
        np.testing.assert_allclose(again, plan.run(traces).values, atol=1e-9 * np.abs(again).max())  # type: ignore[union-attr]


@pytest.mark.parametrize(
    "samples", [pytest.param(256, marks=pytest.mark.long), pytest.param(1024, marks=pytest.mark.nightly)]
)
@pytest.mark.timeout(900)
def test_at_full_size_they_agree_within_the_tolerance(samples: int) -> None:
    """The paper's: 1,605 sensors, 226 × 226 modes, 1,024 samples or a quarter of them, in the usual precision."""
    mask = equi_steradian_mask(13.56e-3, 3.6e-3, 1600)
    plan = flat_plan(mask, samples=samples, sampling_interval=8e-9, sound_speed=1480.0, modes=226)
    traces = np.random.default_rng(1).standard_normal((mask.count, samples), dtype=np.float32)
    found = plan.run(traces).values  # type: ignore[union-attr]
    expected = run_inverse(ReferenceEngine(plan.tables), traces)
    assert found.dtype == expected.dtype == np.float32
    assert np.linalg.norm(found - expected) <= 1e-5 * np.linalg.norm(expected)


def test_an_inversion_has_no_transpose_and_work_is_cancelled() -> None:
    plan = flat_plan(ANYWHERE, samples=101, aperture=SIDE, modes=24, **COMMON)
    engine: NumbaEngine = plan.engine
    with pytest.raises(NotImplementedError):
        engine.to_image_adjoint(np.zeros(plan.geometry.shape))
    with pytest.raises(Cancelled):
        engine.lateral(np.zeros((60, 101)), ProgressMonitor(cancelled=lambda: True))


@pytest.mark.parametrize(("count", "dtype"), [(1, "float32"), (7, "float32"), (32, "float64"), (1 << 20, "float32")])
def test_room_for_vectors_begins_on_a_line_of_the_cache(count: int, dtype: str) -> None:
    found = aligned_empty(count, dtype)
    assert found.shape == (count,)
    assert found.dtype == dtype
    assert found.ctypes.data % CACHE_LINE_BYTES == 0
