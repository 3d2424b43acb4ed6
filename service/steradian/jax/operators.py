"""Differentiable forward operator and direct reconstruction of JAX arrays."""

from __future__ import annotations

from typing import Any, TypeAlias

import jax.numpy as jnp

from steradian.core.exceptions import InvalidInput
from steradian.imaging.options import Compute
from steradian.imaging.parametric.differentiable import DifferentiableInversion, DifferentiableModel, check_array
from steradian.jax.functions import (
    attenuation_function,
    check_parameters,
    given,
    linear_product,
    parametric_product,
)

Array: TypeAlias = Any
Parameter: TypeAlias = Any


class ForwardOperator(DifferentiableModel):
    """Differentiable forward operator from volumes to A-lines: :class:`steradian.ForwardOperator` of JAX arrays.

    Parameters and errors are those of :class:`.DifferentiableModel`, on the CPU; float64 is that of ``jax_enable_x64``.
    """

    def __init__(self, *arguments: Any, compute: Compute = Compute(device="cpu"), **named: Any) -> None:
        super().__init__(*arguments, compute=compute, **named)
        self._products: dict[Any, Any] = {}  # traced once

    def __call__(
        self,
        image: Array,
        *,
        positions: Array | None = None,
        sound_speed: Parameter = None,
        time_zero: Parameter = None,
    ) -> Array:
        """Return the A-lines (…, M, N_t) of images (…, x, y, z), or (…, x, z) in 2-D.

        Parameters and errors are those of :class:`.DifferentiableModel`. A number out of range raises an error of the
        callback, which names it.
        """
        dtype = _check("image", image, self.volume_shape)
        if positions is None and sound_speed is None and time_zero is None:
            return self._product(dtype, False)(image)
        traces = self._varied(dtype, False, image, positions, sound_speed, time_zero)
        matrix = self._attenuation(dtype, sound_speed, time_zero)
        return self._scaled(traces if matrix is None else traces @ matrix.T)

    def adjoint(
        self,
        traces: Array,
        *,
        positions: Array | None = None,
        sound_speed: Parameter = None,
        time_zero: Parameter = None,
    ) -> Array:
        """Return the adjoint (…, x, y, z) of A-lines (…, M, N_t); parameters and errors as in calls."""
        dtype = _check("traces", traces, self.trace_shape)
        if positions is None and sound_speed is None and time_zero is None:
            return self._product(dtype, True)(traces)
        matrix, lines = self._attenuation(dtype, sound_speed, time_zero), self._scaled(traces)
        lines = lines if matrix is None else lines @ matrix
        return self._varied(dtype, True, lines, positions, sound_speed, time_zero)

    def _product(self, dtype: str, adjoint: bool) -> Any:
        key = dtype, adjoint
        if key not in self._products:
            plain = self.plain(dtype)
            volume, traces = self.volume_shape, self.trace_shape
            self._products[key] = (
                linear_product(plain.backward, plain.forward, traces, volume)
                if adjoint
                else linear_product(plain.forward, plain.backward, volume, traces)
            )
        return self._products[key]

    def _varied(self, dtype: str, adjoint: bool, values: Array, *parameters: Any) -> Array:
        timed = not (parameters[1] is None and parameters[2] is None)
        transform, key = self.parametric(dtype, timed=timed), (dtype, adjoint, timed)
        check_parameters(transform, *parameters)
        if key not in self._products:
            self._products[key] = parametric_product(transform, adjoint)
        return self._products[key](values, *given(*parameters))

    def _scaled(self, traces: Array) -> Array:
        factors = self.sensitivity
        return traces if factors is None else traces * jnp.asarray(factors, traces.dtype)[:, None]

    def _attenuation(self, dtype: str, sound_speed: Parameter, time_zero: Parameter) -> Array | None:
        if not self.attenuated:
            return None
        if dtype not in self._products:
            self._products[dtype] = attenuation_function(self, dtype)
        return self._products[dtype](*given(None, sound_speed, time_zero)[1:])


class DirectReconstruction(DifferentiableInversion):
    """Differentiable direct reconstruction (paper, equation 7): volumes of A-lines as JAX arrays.

    Parameters, image and errors are those of :class:`.DifferentiableInversion`, on the CPU.
    """

    def __init__(self, *arguments: Any, compute: Compute = Compute(device="cpu"), **named: Any) -> None:
        super().__init__(*arguments, compute=compute, **named)
        self._products: dict[tuple[str, bool], Any] = {}  # traced once

    def __call__(
        self,
        traces: Array,
        *,
        positions: Array | None = None,
        sound_speed: Parameter = None,
        time_zero: Parameter = None,
        weights: Array | None = None,
    ) -> Array:
        """Return the images (…, x, y, z) of A-lines (…, M, N_t); parameters and errors as in the forward operator."""
        dtype = _check("traces", traces, self.trace_shape)
        weighted = traces * self._weights(traces, weights)
        return self._varied(dtype, True, weighted, positions, sound_speed, time_zero)

    def adjoint(
        self,
        image: Array,
        *,
        positions: Array | None = None,
        sound_speed: Parameter = None,
        time_zero: Parameter = None,
        weights: Array | None = None,
    ) -> Array:
        """Return the adjoint (…, M, N_t) of images (…, x, y, z); parameters and errors as in calls."""
        dtype = _check("image", image, self.volume_shape)
        found = self._varied(dtype, False, image, positions, sound_speed, time_zero)
        return found * self._weights(found, weights)

    def _varied(self, dtype: str, adjoint: bool, values: Array, *parameters: Any) -> Array:
        transform, key = self.parametric(dtype), (dtype, adjoint)
        check_parameters(transform, *parameters)
        if key not in self._products:
            self._products[key] = parametric_product(transform, adjoint)
        return self._products[key](values, *given(*parameters))

    def _weights(self, other: Array, weights: Array | None) -> Array:
        used = self.weights if weights is None else jnp.asarray(weights)
        if used.shape != self.weights.shape:
            raise InvalidInput("weights", f"an array of shape {tuple(used.shape)}", f"shape {self.weights.shape}")
        return jnp.asarray(used, other.dtype)[:, None]


def _check(name: str, values: Array, wanted: tuple[int, ...]) -> str:
    return check_array(name, str(jnp.result_type(values)), tuple(jnp.shape(values)), wanted)
