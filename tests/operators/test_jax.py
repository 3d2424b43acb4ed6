"""JAX operators: products of the library and gradients of all parameters, forwards and backwards, compiled."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import steradian
from steradian.core.exceptions import InvalidInput
from steradian.imaging import Compute, Nufft
from support.small_acquisitions import BEGINS, GRID, PLACES, small_geometry

jax = pytest.importorskip("jax", reason="JAX: pip install --no-deps -r constraints-operators.txt")
jax.config.update("jax_enable_x64", True)
steradian_jax = pytest.importorskip("steradian.jax")
check_grads = pytest.importorskip("jax.test_util").check_grads
RNG = np.random.default_rng(1)
CHECK: dict[str, Any] = {"order": 1, "modes": ("fwd", "rev"), "eps": 1e-5, "atol": 1e-6, "rtol": 1e-6}
SCALED = (1e3 * PLACES, 1e6 * BEGINS, 1.5)


def named(positions: Any, time_zero: Any, sound_speed: Any) -> dict[str, Any]:
    return {"positions": 1e-3 * positions, "time_zero": 1e-6 * time_zero, "sound_speed": 1e3 * sound_speed}


@pytest.mark.parametrize("medium", ["lossless", "attenuating", "layers"])
def test_gradients_of_the_model_are_difference_quotients(medium: str) -> None:
    operator = steradian_jax.ForwardOperator(small_geometry(medium), GRID, tolerance=1e-12)
    image, traces = RNG.random(operator.volume_shape), RNG.random((2, *operator.trace_shape))
    check_grads(operator, (image,), order=2, modes=("fwd", "rev"), atol=1e-6, rtol=1e-6)
    scaled = (*SCALED[:2], np.array([1.48, 1.54])) if medium == "layers" else SCALED
    check = CHECK | {"rtol": 5e-6} if medium == "layers" else CHECK  # waves near a critical angle change abruptly
    check_grads(jax.jit(lambda f, *p: operator(f, **named(*p))), (image, *scaled), **check)
    check_grads(lambda g, *p: operator.adjoint(g, **named(*p)), (traces, *scaled), **check)


def test_gradients_of_the_direct_reconstruction_are_difference_quotients() -> None:
    geometry = replace(small_geometry(), sensitivity=None)
    direct = steradian_jax.DirectReconstruction(geometry, GRID, Nufft(tolerance=1e-12))
    traces, image = RNG.random(direct.trace_shape), RNG.random(direct.volume_shape)
    check_grads(lambda g, *p: direct(g, **named(*p)), (traces, *SCALED), **CHECK)
    check_grads(lambda f, *p: direct.adjoint(f, **named(*p)), (image, *SCALED), **CHECK)


def test_products_are_those_of_the_library_also_compiled() -> None:
    library = steradian.ForwardOperator(small_geometry(), GRID, compute=Compute(dtype="float64"))
    operator = steradian_jax.ForwardOperator(small_geometry(), GRID)
    images = RNG.random((3, *operator.volume_shape))
    expected = np.stack([library.forward(image) for image in images])
    for found in (operator(images), jax.jit(operator)(images)):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_products_are_compiled_once() -> None:
    operator = steradian_jax.ForwardOperator(small_geometry(), GRID)
    image = np.ones(operator.volume_shape)
    gradient = jax.grad(lambda x: (operator(image, positions=x) ** 2).sum())
    gradient(PLACES)
    compiled: list[str] = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: compiled.append(event) if "backend_compile" in event else None
    )
    try:
        for _ in range(3):
            gradient(PLACES)
    finally:
        jax.monitoring.clear_event_listeners()
    assert not compiled


def test_mixed_derivatives_by_image_and_positions_are_difference_quotients() -> None:
    operator = steradian_jax.ForwardOperator(small_geometry(), GRID, tolerance=1e-12)
    image = RNG.random(operator.volume_shape)

    def by_positions(image: Any) -> Any:
        return jax.grad(lambda x: (1e-3 * operator(image, positions=1e-3 * x)).sum())(1e3 * PLACES)

    check_grads(by_positions, (image,), order=1, modes=("rev",), eps=1e-3, atol=1e-6, rtol=1e-6)


def test_second_derivatives_by_parameters_are_refused_and_wrong_input_too() -> None:
    operator = steradian_jax.ForwardOperator(small_geometry(), GRID)
    image = RNG.random(operator.volume_shape)
    with pytest.raises(NotImplementedError, match="second derivatives"):
        jax.hessian(lambda x: (operator(image, positions=x) ** 2).sum())(PLACES)
    with pytest.raises(InvalidInput, match="image"):
        operator(np.zeros((3, 3, 3)))
    for name, value in (("positions", np.zeros((4, 2))), ("sound_speed", np.ones(2)), ("time_zero", np.zeros(2))):
        with pytest.raises(InvalidInput, match=name):
            operator(image, **{name: value})
    with pytest.raises(InvalidInput, match="traces"):
        operator.adjoint(np.zeros(operator.trace_shape, np.int32))
