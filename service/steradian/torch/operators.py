"""Differentiable forward operator and direct reconstruction of PyTorch tensors."""

from __future__ import annotations

import torch
from torch import Tensor

from steradian.core.exceptions import InvalidInput
from steradian.imaging.parametric.differentiable import DifferentiableInversion, DifferentiableModel, check_array
from steradian.torch.functions import AttenuationMatrix, Parameter, ParametricProduct, Product, apply


class ForwardOperator(DifferentiableModel):
    """Differentiable forward operator from volumes to A-lines: :class:`steradian.ForwardOperator` of tensors.

    Parameters and errors are those of :class:`.DifferentiableModel`.
    """

    def __call__(
        self,
        image: Tensor,
        *,
        positions: Tensor | None = None,
        sound_speed: Parameter = None,
        time_zero: Parameter = None,
    ) -> Tensor:
        """Return the A-lines (…, M, N_t) of images (…, x, y, z), or (…, x, z) in 2-D.

        Parameters and errors are those of :class:`.DifferentiableModel`; parameters are numbers or tensors.
        """
        dtype = _check("image", image, self.volume_shape)
        if positions is None and sound_speed is None and time_zero is None:
            return apply(Product, self.plain(dtype), False, image)
        transform = self.parametric(dtype, timed=not (sound_speed is None and time_zero is None))
        traces = apply(ParametricProduct, transform, False, image, positions, sound_speed, time_zero)
        matrix = self._attenuation(traces, sound_speed, time_zero)
        return self._scaled(traces if matrix is None else traces @ matrix.T)

    def adjoint(
        self,
        traces: Tensor,
        *,
        positions: Tensor | None = None,
        sound_speed: Parameter = None,
        time_zero: Parameter = None,
    ) -> Tensor:
        """Return the adjoint (…, x, y, z) of A-lines (…, M, N_t); parameters and errors as in calls."""
        dtype = _check("traces", traces, self.trace_shape)
        if positions is None and sound_speed is None and time_zero is None:
            return apply(Product, self.plain(dtype), True, traces)
        matrix, given = self._attenuation(traces, sound_speed, time_zero), self._scaled(traces)
        given = given if matrix is None else given @ matrix
        transform = self.parametric(dtype, timed=not (sound_speed is None and time_zero is None))
        return apply(ParametricProduct, transform, True, given, positions, sound_speed, time_zero)

    def _scaled(self, traces: Tensor) -> Tensor:
        factors = self.sensitivity
        return traces if factors is None else traces * torch.as_tensor(factors).to(traces)[:, None]

    def _attenuation(self, other: Tensor, sound_speed: Parameter, time_zero: Parameter) -> Tensor | None:
        return apply(AttenuationMatrix, self, sound_speed, time_zero).to(other) if self.attenuated else None


class DirectReconstruction(DifferentiableInversion):
    """Differentiable direct reconstruction (paper, equation 7): volumes of A-lines as tensors.

    Parameters, image and errors are those of :class:`.DifferentiableInversion`.
    """

    def __call__(
        self,
        traces: Tensor,
        *,
        positions: Tensor | None = None,
        sound_speed: Parameter = None,
        time_zero: Parameter = None,
        weights: Tensor | None = None,
    ) -> Tensor:
        """Return the images (…, x, y, z) of A-lines (…, M, N_t); parameters and errors as in the forward operator."""
        dtype = _check("traces", traces, self.trace_shape)
        weighted = traces * self._weights(traces, weights)
        return apply(ParametricProduct, self.parametric(dtype), True, weighted, positions, sound_speed, time_zero)

    def adjoint(
        self,
        image: Tensor,
        *,
        positions: Tensor | None = None,
        sound_speed: Parameter = None,
        time_zero: Parameter = None,
        weights: Tensor | None = None,
    ) -> Tensor:
        """Return the adjoint (…, M, N_t) of images (…, x, y, z); parameters and errors as in calls."""
        dtype = _check("image", image, self.volume_shape)
        found = apply(ParametricProduct, self.parametric(dtype), False, image, positions, sound_speed, time_zero)
        return found * self._weights(found, weights)

    def _weights(self, other: Tensor, weights: Tensor | None) -> Tensor:
        used = torch.from_numpy(self.weights) if weights is None else torch.as_tensor(weights)
        if used.shape != self.weights.shape:
            raise InvalidInput("weights", f"a tensor of shape {tuple(used.shape)}", f"shape {self.weights.shape}")
        return used.to(other)[:, None]


def _check(name: str, values: Tensor, wanted: tuple[int, ...]) -> str:
    if not isinstance(values, Tensor):
        raise InvalidInput(name, type(values).__name__, "a tensor")
    return check_array(name, str(values.dtype).removeprefix("torch."), tuple(values.shape), wanted)
