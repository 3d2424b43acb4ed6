"""The GPU's engine computes what the array engine says; where there is no GPU, in Numba's simulator."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.imaging import (
    AcquisitionGeometry,
    Compute,
    ElasticFilm,
    ImageGrid,
    InverseFilter,
    Nufft,
    direct_spectrum,
    kaiser_bessel,
    spectrum_of,
)
from steradian.imaging.engines import ProgressMonitor, run_forward, run_inverse
from steradian.imaging.engines.numba.engine import NumbaEngine
from steradian.imaging.operators import ForwardOperator
from steradian.imaging.parametric.models import parametric_inversion
from steradian.imaging.transform_tables import moved
from support.flat import flat_operator, flat_plan
from support.reference_engine import ReferenceEngine

SIDE = 1e-3
RNG = np.random.default_rng(0)
ANYWHERE = (RNG.random((9, 2)) - 0.5) * SIDE
COMMON: dict[str, Any] = {  # engines agree to rounding, whatever the tolerance; a large one has small stencils
    "samples": 18, "aperture": SIDE, "sampling_interval": 8e-9, "sound_speed": 1500.0, "dtype": "float64",
    "tolerance": 1e-2,
}  # fmt: skip
Make = Callable[..., Any]


def _grid(count: int, displaced: float = 0.0) -> np.ndarray:
    axis = (np.arange(count) - count // 2 + displaced) * SIDE / count
    return np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)


SETTINGS: dict[str, tuple[np.ndarray, dict[str, Any]]] = {
    "anywhere": (ANYWHERE, {"modes": (6, 5)}),
    "padded": (
        ANYWHERE,
        {"modes": (5, 6), "aperture": (SIDE, 1.5 * SIDE), "time_padding": 1.5, "lateral_padding": 1.4,
         "time_zero": 3.3e-8, "samples": 15},
    ),
    "grid, upsampled, some depths": (_grid(6), {"modes": 6, "upsampling": 2, "depth_range": (2.4e-5, 1.2e-4)}),
    "coarser grid": (_grid(3), {"modes": 6}),
    "coarser grid, displaced": (_grid(3, 0.25), {"modes": 6}),
    "displaced grid": (_grid(6, 0.25), {"modes": 6}),
    "line": ((RNG.random(9) - 0.5) * SIDE, {"modes": 16}),
    "linear": (ANYWHERE, {"modes": 6, "method": "linear"}),
    "nearest": (_grid(4), {"modes": 4, "method": "nearest"}),
    "interpolated": (ANYWHERE, {"modes": 6, "method": "interpolated"}),
    "filtered": (ANYWHERE, {"modes": 6, "correction": InverseFilter(ElasticFilm())}),
    "the paper's window": (ANYWHERE, {"modes": 6, "window": kaiser_bessel(3, 2.0)}),
    "a band": (ANYWHERE, {"modes": 6, "samples": 130, "highest_frequency": 4e6}),
}  # fmt: skip


@pytest.mark.parametrize("setting", SETTINGS)
def test_both_engines_make_the_same_image(setting: str, cuda: Make) -> None:
    positions, options = SETTINGS[setting]
    plan = flat_plan(positions, **{**COMMON, **options})
    engine = cuda(plan.tables)
    traces = plan.decimate(RNG.standard_normal((len(positions), plan.geometry.samples)))
    expected = run_inverse(ReferenceEngine(plan.tables), traces)
    found = engine.host(run_inverse(engine, traces))
    assert np.linalg.norm(found - expected) <= 1e-12 * np.linalg.norm(expected)


@pytest.mark.parametrize("setting", ["anywhere", "padded", "line", "grid"])
def test_both_engines_make_the_same_a_lines_and_their_transpose(setting: str, cuda: Make) -> None:
    model = _model(*((_grid(4), {"modes": 4}) if setting == "grid" else SETTINGS[setting]))
    array, engine = ReferenceEngine(model.tables), cuda(model.tables)
    volume, traces = RNG.standard_normal(model.volume_shape), RNG.standard_normal(model.trace_shape)
    for found, expected in (
        (run_forward(engine, volume), run_forward(array, volume)),
        (run_inverse(engine, traces), run_inverse(array, traces)),
    ):
        assert np.linalg.norm(engine.host(found) - expected) <= 1e-12 * np.linalg.norm(expected)


def test_inversion_s_transpose_and_derivatives_by_positions_are_the_processor_s(cuda: Make) -> None:
    exact = Compute(dtype="float64")
    geometry = AcquisitionGeometry(ANYWHERE, 12, dt=8e-9, sound_speed=1500.0, t0=3.3e-8, aperture=SIDE)
    transform = parametric_inversion(geometry, ImageGrid(modes=(5, 6)), Nufft(tolerance=1e-2), compute=exact)
    tables = transform.engine(transform.parameters(), "none").engine.tables
    both = NumbaEngine(tables, threads=1), cuda(tables)
    image, traces = RNG.standard_normal(transform.volume_shape), RNG.standard_normal(transform.trace_shape)
    for derivative in (None, 0, 1):
        sensors = moved(tables, 0.9 * ANYWHERE, derivative)
        host, device = (engine.with_sensors(sensors) for engine in both)
        for product, values in ((run_forward, image), (run_inverse, traces)):
            expected = product(host, values.copy())
            assert np.linalg.norm(device.host(product(device, values)) - expected) <= 1e-12 * np.linalg.norm(expected)


def _model(positions: np.ndarray, options: dict[str, Any]) -> ForwardOperator:
    chosen = {name: value for name, value in options.items() if name != "time_padding"}
    return flat_operator(positions, response=ElasticFilm(), **{**COMMON, "samples": 12, **chosen})


def test_the_adjoint_is_one(cuda: Make) -> None:
    """⟨A f, g⟩ = ⟨f, Aᵀ g⟩, by the GPU's steps alone."""
    model = _model(*SETTINGS["anywhere"])
    engine = cuda(model.tables)
    volume, traces = RNG.standard_normal(model.volume_shape), RNG.standard_normal(model.trace_shape)
    forward, backward = engine.host(run_forward(engine, volume)), engine.host(run_inverse(engine, traces))
    size = np.linalg.norm(forward) * np.linalg.norm(traces)
    assert abs(np.vdot(forward, traces) - np.vdot(volume, backward)) <= 1e-13 * size


def test_the_image_has_the_spectrum_of_the_direct_sums(cuda: Make) -> None:
    plan = flat_plan(ANYWHERE, modes=(6, 5), **{**COMMON, "dtype": "float32", "tolerance": 1e-4})
    traces = RNG.standard_normal((9, 18)).astype(np.float32)
    engine = cuda(plan.tables)
    image = engine.host(run_inverse(engine, traces))
    assert image.dtype == np.float32
    j = np.array([(x, y) for x in (-3, -1, 0, 2) for y in (-2, 0, 1)])
    l = np.repeat([[1, 3, 8]], len(j), axis=0)  # noqa: E741
    j, l = np.repeat(j, 3, axis=0), l.ravel()  # noqa: E741
    g = plan.geometry
    expected = direct_spectrum(
        traces, g.positions, j, l, sampling_interval=8e-9, sound_speed=1500.0, aperture=SIDE, modes=(6, 5),
        weights=g.weights,
    )  # fmt: skip
    error = np.linalg.norm(spectrum_of(image, j, l) - expected) / np.linalg.norm(expected)
    assert error <= 1e-4


@pytest.mark.parametrize("setting", ["anywhere", "padded", "grid, upsampled, some depths", "coarser grid"])
def test_in_pieces_it_is_the_same_image(setting: str, cuda: Make) -> None:
    positions, options = SETTINGS[setting]
    plan = flat_plan(positions, **{**COMMON, **options})
    traces = RNG.standard_normal((len(positions), plan.geometry.samples))
    whole = cuda(plan.tables)
    pieces = cuda(plan.tables, device_memory=_least(plan.tables, cuda))
    assert whole.room.fits_in_one_pass
    assert not pieces.room.fits_in_one_pass
    assert pieces.room.frequencies < whole.room.frequencies
    expected = whole.host(run_inverse(whole, traces))
    found = run_inverse(pieces, traces)
    assert isinstance(found, np.ndarray)
    assert np.linalg.norm(found - expected) <= 1e-13 * np.linalg.norm(expected)


def test_in_pieces_the_model_is_the_same(cuda: Make) -> None:
    model = _model(*SETTINGS["padded"])
    whole, pieces = cuda(model.tables), cuda(model.tables, device_memory=_least(model.tables, cuda))
    volume, traces = RNG.standard_normal(model.volume_shape), RNG.standard_normal(model.trace_shape)
    for make, given in ((run_forward, volume), (run_inverse, traces)):
        expected = whole.host(make(whole, given))
        found = pieces.host(make(pieces, given))
        assert np.linalg.norm(found - expected) <= 1e-13 * np.linalg.norm(expected)


def _least(tables: Any, cuda: Make) -> int:
    """Bytes that the smallest pieces take, as the refusal of less tells."""
    with pytest.raises(InvalidInput, match="bytes for an image of") as refused:
        cuda(tables, device_memory=1)
    assert refused.value.field == "device_memory"
    return int(str(refused.value.allowed).split()[2])


def test_it_is_the_same_bits_every_time(cuda: Make) -> None:
    plan = flat_plan(ANYWHERE, modes=(6, 5), **{**COMMON, "dtype": "float32"})
    engine, traces = cuda(plan.tables), RNG.standard_normal((9, 18)).astype(np.float32)
    first, again = (engine.host(run_inverse(engine, traces)) for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_lateral_accumulates_sensor_subsets(cuda: Make) -> None:
    plan = flat_plan(ANYWHERE, modes=(6, 5), **COMMON)
    engine, traces = cuda(plan.tables), RNG.standard_normal((9, 18))
    some = engine.lateral(traces[:4], sensors=np.arange(4))
    both = engine.lateral(traces[4:], sensors=np.arange(4, 9), onto=some)
    kept = engine.host(engine.to_image(engine.to_depth(both, kept=True)))
    again = engine.host(engine.to_image(engine.to_depth(both)))
    np.testing.assert_array_equal(kept, again)
    expected = engine.host(run_inverse(engine, traces))
    np.testing.assert_allclose(again, expected, atol=1e-13 * np.abs(expected).max())


def test_it_decimates_as_the_processor_does(cuda: Make) -> None:
    plan = flat_plan(ANYWHERE, **{**COMMON, **SETTINGS["a band"][1]})
    assert plan.tables.decimation is not None
    traces = RNG.standard_normal((9, 130))
    engine = cuda(plan.tables)
    expected = engine.host(run_inverse(engine, plan.decimate(traces)))
    found = engine.host(run_inverse(engine, traces))
    assert np.linalg.norm(found - expected) <= 1e-13 * np.linalg.norm(expected)


def test_unsupported_operation_cancellation_and_bad_values_raise(cuda: Make) -> None:
    plan = flat_plan(ANYWHERE, modes=(6, 5), **{**COMMON, "dtype": "float32"})
    engine = cuda(plan.tables)
    with pytest.raises(NotImplementedError):
        engine.to_image_adjoint(np.zeros(plan.geometry.shape))
    with pytest.raises(Cancelled):
        engine.lateral(np.zeros((9, 18)), ProgressMonitor(cancelled=lambda: True))
    for value, what in ((np.nan, "nan at row 2, column 5"), (3e30, "beyond the range")):
        traces = np.ones((9, 18))
        traces[2, 5] = value
        with pytest.raises(InvalidInput, match=what):
            engine.lateral(traces)
