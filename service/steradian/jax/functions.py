"""Differentiable JAX functions of products that are computed on the host."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import linear_call

from steradian.core.exceptions import InvalidInput
from steradian.imaging.parametric.differentiable import DifferentiableModel
from steradian.imaging.parametric.transform import ParametricTransform, TransformAt

Array: TypeAlias = Any


def given(*parameters: Any) -> tuple[Array, ...]:
    """Return parameters as arrays; an empty one stands for one that is not given."""
    return tuple(jnp.zeros(0) if each is None else jnp.asarray(each) for each in parameters)


def number(value: Any) -> float | None:
    """Return a parameter as a number, None where it is not given."""
    return None if np.size(value) == 0 else float(np.asarray(value).reshape(()))


def attenuation_function(model: DifferentiableModel, dtype: str) -> Callable[..., Array]:
    """Return the attenuation matrix (N_t, N_t) as a function of sound speed and time zero."""
    samples = model.trace_shape[1]
    one, two = (jax.ShapeDtypeStruct(shape, dtype) for shape in ((samples, samples), (2, samples, samples)))

    def host(make: Callable[..., Any], speed: Any, begins: Any) -> Any:
        return np.asarray(make(number(speed), number(begins)), dtype)

    @jax.custom_jvp
    def matrix(speed: Array, begins: Array) -> Array:
        return jax.pure_callback(partial(host, model.attenuation), one, speed, begins)

    @matrix.defjvp
    def _(primals: Any, tangents: Any) -> Any:
        by_speed, by_time = jax.pure_callback(partial(host, model.attenuation_derivatives), two, *primals)
        of_speed, of_time = (each.astype(dtype).sum() for each in tangents)
        return matrix(*primals), by_speed * of_speed + by_time * of_time

    return jax.jit(matrix)  # type: ignore[no-any-return]


def check_parameters(transform: ParametricTransform, positions: Any, sound_speed: Any, time_zero: Any) -> None:
    """Raise :class:`InvalidInput` where the shape of a parameter does not fit, before anything is traced."""
    wanted = transform.geometry.positions.shape
    if positions is not None and jnp.shape(positions) != wanted:
        raise InvalidInput("positions", f"an array of shape {jnp.shape(positions)}", f"shape {wanted}")
    for name, value, count in (("sound_speed", sound_speed, len(transform.sound_speeds)), ("time_zero", time_zero, 1)):
        if value is not None and jnp.size(value) != count:
            raise InvalidInput(name, f"{jnp.size(value)} numbers", f"{count}")


def _on_host(function: Callable[..., Any], axes: int, shape: tuple[int, ...]) -> Callable[..., Array]:
    """Return a function of arrays with ``axes`` own axes and of parameters, computed on the host; results of ``shape``.

    JAX refuses to differentiate it.
    """

    def host(given: Any, *parameters: Any) -> Any:
        batch, own = given.shape[: given.ndim - axes], given.shape[given.ndim - axes :]
        found = [function(one, *parameters) for one in np.asarray(given).reshape(-1, *own)]
        return np.stack(found).reshape(*batch, *shape).astype(given.dtype, copy=False)

    def compute(values: Array, *parameters: Array) -> Array:
        kind = jax.ShapeDtypeStruct((*values.shape[: values.ndim - axes], *shape), values.dtype)
        return jax.pure_callback(host, kind, values, *parameters, vmap_method="sequential")

    return compute


def linear_product(
    product: Callable[..., Any], transpose: Callable[..., Any], own: tuple[int, ...], other: tuple[int, ...]
) -> Callable[..., Array]:
    """Return a linear function of values, which parameters may follow, and its transpose, computed on the host."""
    there, back = _on_host(product, len(own), other), _on_host(transpose, len(other), own)

    def apply(values: Array, *parameters: Array) -> Array:
        return linear_call(lambda p, v: there(v, *p), lambda p, v: back(v, *p), parameters, values)

    return jax.jit(apply)  # type: ignore[no-any-return]


def parametric_product(transform: ParametricTransform, adjoint: bool) -> Callable[..., Array]:
    """Return the product with a transform, or its transpose, as a function of values and parameters."""
    volume, traces = transform.volume_shape, transform.trace_shape
    shapes = (traces, volume) if adjoint else (volume, traces)
    directions = ("to_image", "to_traces") if adjoint else ("to_traces", "to_image")
    moved = (len(transform.geometry.period), *traces)

    def at(x: Any, speed: Any, begins: Any) -> TransformAt:
        positions = None if np.size(x) == 0 else np.asarray(x, np.float64)
        speeds = None if np.size(speed) == 0 else np.asarray(speed, np.float64)
        return transform.at(transform.parameters(positions, speeds, number(begins)))

    def method(name: str) -> Callable[..., Any]:
        return lambda values, *parameters: getattr(at(*parameters), name)(np.asarray(values))

    linear = linear_product(method(directions[0]), method(directions[1]), *shapes)
    layers = len(transform.sound_speeds)
    by_speeds = _on_host(method(f"speeds_{directions[0]}"), len(shapes[0]), (layers, *shapes[1]))
    by_time = linear_product(method(f"time_{directions[0]}"), method(f"time_{directions[1]}"), *shapes)
    by_positions = linear_product(method("positions_to_traces"), method("positions_to_image"), volume, moved)
    from_positions = linear_product(method("positions_to_image"), method("positions_to_traces"), moved, volume)

    @jax.custom_jvp
    def product(values: Array, *parameters: Array) -> Array:
        return linear(values, *parameters)

    def differentiate(primals: Any, tangents: Any) -> Any:
        values, *parameters = primals[0], *map(_differentiated_once, primals[1:])
        found = linear(values, *parameters)
        of_values, of_positions, of_speeds, of_time = tangents
        change = jnp.zeros_like(found)
        if not _is_zero(of_values):
            change += linear(of_values, *parameters)
        if not _is_zero(of_positions) and of_positions.size:
            steps = of_positions.T[:, :, None].astype(found.dtype)
            if adjoint:
                change += from_positions(values[..., None, :, :] * steps, *parameters)
            else:
                change += (by_positions(values, *parameters) * steps).sum(-3)
        if not _is_zero(of_speeds) and of_speeds.size:
            axes = len(shapes[1])
            steps = of_speeds.astype(found.dtype).reshape(layers, *(1,) * axes)
            change += (by_speeds(values, *parameters) * steps).sum(-axes - 1)
        if not _is_zero(of_time) and of_time.size:
            change += by_time(values, *parameters) * of_time.astype(found.dtype).reshape(())
        return found, change

    product.defjvp(differentiate, symbolic_zeros=True)
    return jax.jit(product)  # type: ignore[no-any-return]


@jax.custom_jvp
def _differentiated_once(parameter: Array) -> Array:
    return parameter


def _refuse(primals: Any, tangents: Any) -> Any:
    if not _is_zero(tangents[0]):
        raise NotImplementedError("second derivatives by positions, sound speed or time zero")
    return primals[0], jnp.zeros_like(primals[0])


_differentiated_once.defjvp(_refuse, symbolic_zeros=True)


def _is_zero(tangent: Any) -> bool:
    return type(tangent).__name__ == "SymbolicZero"
