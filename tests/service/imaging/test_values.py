"""Value objects of the library: acquisition, image grid, methods and execution options."""

from __future__ import annotations

import inspect
from dataclasses import FrozenInstanceError, replace
from typing import Any

import numpy as np
import pytest

import steradian
from steradian import (
    Acquisition,
    AcquisitionGeometry,
    Compute,
    ForwardOperator,
    Gridded,
    ImageGrid,
    InvalidInput,
    Iterative,
    LinearKappa,
    NearestKappa,
    Ner,
    Nufft,
    ReconstructionPlan,
    equi_steradian_mask,
    reconstruct,
)
from steradian.imaging import ElasticFilm, InverseFilter, Method
from steradian.imaging.iterative.solve import solve

MASK = equi_steradian_mask(10e-3, 3e-3, 60)
TRACES = np.random.default_rng(0).standard_normal((MASK.count, 96)).astype(np.float32)
ACQUISITION = Acquisition(TRACES, MASK, dt=16e-9, sound_speed=1500.0)
GRID = ImageGrid(16, depth=(0.5e-3, 1.5e-3))
CPU = Compute(device="cpu")
METHODS: tuple[Method, ...] = (Nufft(), LinearKappa(), NearestKappa(), Gridded(), Iterative(iterations=2))


def test_public_functions_take_at_most_seven_parameters() -> None:
    for function in (reconstruct, ReconstructionPlan, ForwardOperator, solve):
        assert len(inspect.signature(function).parameters) <= 7


@pytest.mark.parametrize("value", [ACQUISITION, ACQUISITION.geometry, GRID, CPU, *METHODS, Ner()])
def test_values_are_frozen_and_exported(value: object) -> None:
    assert getattr(steradian, type(value).__name__) is type(value)
    with pytest.raises((FrozenInstanceError, TypeError)):
        value.dt = value.modes = value.device = value.tolerance = 1.0  # type: ignore[attr-defined]


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_info_has_the_method_and_device_used(method: Method) -> None:
    info = reconstruct(ACQUISITION, GRID, method, compute=CPU).info
    assert info is not None
    assert (info.method, info.device, info.notes) == (method.name, "cpu", ())
    assert info.memory_bytes > 0


def test_info_of_direct_method_has_band_but_no_iterations() -> None:
    for limit, expected in ((None, None), (10e6, 10e6)):
        info = reconstruct(ACQUISITION, GRID, Nufft(max_frequency=limit), compute=CPU).info
        assert info is not None
        assert info.max_frequency == expected
        assert (info.iterations, info.stop_reason, info.residuals) == (0, "", ())
    info = reconstruct(ACQUISITION, GRID, Nufft(max_frequency="signal"), compute=CPU).info
    assert info is not None
    assert info.max_frequency is not None
    assert 0 < info.max_frequency < 0.55 / ACQUISITION.dt


def test_info_of_iterative_method_has_iterations_residuals_and_stop_reason() -> None:
    options = Iterative(regularisation="total-variation", iterations=3, change=0.0, discrepancy=None)
    info = reconstruct(ACQUISITION, GRID, options, compute=CPU).info
    assert info is not None
    assert (info.iterations, info.stop_reason) == (3, "iterations")
    assert len(info.residuals) == 3
    assert info.products > 3
    assert info.max_frequency is not None


def test_plan_gives_the_image_of_reconstruct_by_call_and_run() -> None:
    image = reconstruct(ACQUISITION, GRID, compute=CPU).values
    plan = ReconstructionPlan(ACQUISITION.geometry, GRID, compute=CPU)
    for made in (plan(TRACES), plan.run(TRACES), ReconstructionPlan(ACQUISITION.geometry, GRID)(TRACES)):
        assert isinstance(made, steradian.Volume)
        np.testing.assert_allclose(made.values, image, atol=1e-4 * np.abs(image).max())
    np.testing.assert_array_equal(plan(TRACES).values, image)  # type: ignore[union-attr]
    several = plan(np.stack([TRACES, TRACES]))
    assert isinstance(several, list)
    assert len(several) == 2


def test_geometry_of_acquisition_has_sensors_and_timing_and_makes_the_acquisition_again() -> None:
    given = Acquisition(TRACES, MASK.positions, dt=8e-9, sound_speed=1480.0, t0=1e-6, scale=2.0, aperture=10e-3)
    geometry = given.geometry
    assert (geometry.samples, geometry.dt, geometry.sound_speed, geometry.t0) == (96, 8e-9, 1480.0, 1e-6)
    assert geometry.sensors is MASK.positions
    again = geometry.acquisition(TRACES, scale=2.0)
    assert {name: value for name, value in vars(again).items() if name != "traces"} == {
        name: value for name, value in vars(given).items() if name != "traces"
    }


def test_lists_are_accepted_as_traces() -> None:
    listed = Acquisition(TRACES.tolist(), MASK, dt=16e-9, sound_speed=1500.0)
    expected = reconstruct(ACQUISITION, GRID, compute=CPU).values
    np.testing.assert_allclose(reconstruct(listed, GRID, compute=CPU).values, expected, atol=1e-5)


def test_forward_operator_takes_the_same_geometry_and_grid() -> None:
    model = ForwardOperator(ACQUISITION.geometry, GRID, compute=CPU)
    assert model.trace_shape == TRACES.shape
    assert model.volume_shape == reconstruct(ACQUISITION, GRID, compute=CPU).values.shape


@pytest.mark.parametrize(
    ("field", "make"),
    [
        ("traces", lambda: Acquisition(TRACES[0], MASK, dt=8e-9, sound_speed=1500.0)),
        ("scale", lambda: replace(ACQUISITION, scale=np.nan)),
        ("dt", lambda: replace(ACQUISITION, dt=8.0)),
        ("t0", lambda: replace(ACQUISITION, t0=1.0)),
        ("samples", lambda: AcquisitionGeometry(MASK, 3, dt=8e-9, sound_speed=1500.0)),
        ("samples", lambda: replace(ACQUISITION, traces=TRACES[:, :3]).geometry),
        ("modes", lambda: ImageGrid((16, 4097))),
        ("modes", lambda: ReconstructionPlan(ACQUISITION.geometry, ImageGrid((16, 16, 16)))),
        ("depth", lambda: ImageGrid(16, depth=(2e-3, 1e-3))),
        ("depth", lambda: reconstruct(ACQUISITION, ImageGrid(16, depth=(0.0, 0.1)))),
        ("depth_step", lambda: ImageGrid(16, depth_step=0.0)),
        ("tolerance", lambda: Nufft(tolerance=0.0)),
        ("window", lambda: Ner(window="gauss")),  # type: ignore[arg-type]
        ("max_frequency", lambda: LinearKappa(max_frequency="loud")),  # type: ignore[arg-type]
        ("max_frequency", lambda: reconstruct(ACQUISITION, GRID, Nufft(max_frequency=1.0))),
        ("max_frequency", lambda: ReconstructionPlan(ACQUISITION.geometry, GRID, Nufft(max_frequency="signal"))),
        ("correction", lambda: Nufft(correction=ElasticFilm())),  # type: ignore[arg-type]
        ("correction", lambda: Iterative(correction=ElasticFilm())),  # type: ignore[arg-type]
        ("correction.max_gain", lambda: Iterative(correction=InverseFilter(ElasticFilm(), 20.0))),
        ("max_gain", lambda: InverseFilter(ElasticFilm(), 10_001.0)),
        ("tolerance", lambda: Iterative(tolerance=1.0)),
        ("highest_frequency", lambda: reconstruct(ACQUISITION, GRID, Iterative(highest_frequency=1.0))),
        ("depth_step", lambda: reconstruct(ACQUISITION, ImageGrid(16, depth_step=1e-4), Iterative())),
        ("time_padding", lambda: reconstruct(ACQUISITION, ImageGrid(16, time_padding=2.0), Iterative())),
        ("upsampling", lambda: ForwardOperator(ACQUISITION.geometry, ImageGrid(16, upsampling=2))),
        ("device", lambda: Compute(device="tpu")),  # type: ignore[arg-type]
        ("dtype", lambda: Compute(dtype="float16")),
        ("dtype", lambda: reconstruct(ACQUISITION, GRID, Nufft(tolerance=1e-9), compute=Compute(dtype="float32"))),
        ("threads", lambda: Compute(threads=0)),
        ("memory_limit", lambda: Compute(memory_limit="all")),  # type: ignore[arg-type]
        ("memory_limit", lambda: reconstruct(ACQUISITION, GRID, compute=Compute(device="cpu", memory_limit=10))),
    ],
)
def test_invalid_values_are_rejected_by_their_field(field: str, make: Any) -> None:
    with pytest.raises(InvalidInput) as caught:
        make()
    assert caught.value.field == field
