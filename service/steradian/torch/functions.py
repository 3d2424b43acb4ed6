"""Differentiable PyTorch functions of products with operators and parametric transforms."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from steradian.core.exceptions import InvalidInput
from steradian.imaging.engines.array_namespace import is_gpu_array
from steradian.imaging.operators import ForwardOperator
from steradian.imaging.parametric.differentiable import DifferentiableModel
from steradian.imaging.parametric.transform import ParametricTransform, TransformAt

Parameter: TypeAlias = float | Tensor | None


def apply(function: Any, *arguments: Any) -> Tensor:
    """Return the result of an autograd function as a tensor."""
    found: Tensor = function.apply(*arguments)
    return found


def _each(product: Callable[[Any], Any], values: Tensor, axes: int) -> Tensor:
    """Apply a product of arrays to each element of a batch of tensors with ``axes`` own axes."""
    shape = values.shape[: values.dim() - axes]
    flat = values.detach().reshape(-1, *values.shape[values.dim() - axes :])
    if not len(flat):
        raise InvalidInput("values", f"a batch of shape {tuple(shape)}", "one element or more")
    found = [_as_tensor(product(_as_array(one)), values) for one in flat]
    return found[0].reshape(*shape, *found[0].shape) if len(found) == 1 else _stacked(found, shape)


def _stacked(found: list[Tensor], shape: tuple[int, ...]) -> Tensor:
    stacked = torch.stack(found)
    return stacked.reshape(*shape, *stacked.shape[1:])


def _as_array(values: Tensor) -> Any:
    return values if values.is_cuda else values.numpy(force=True)


def _as_tensor(values: Any, other: Tensor) -> Tensor:
    found = torch.from_dlpack(values) if is_gpu_array(values) else torch.from_numpy(np.asarray(values))
    return found.to(other.device)


class Product(torch.autograd.Function):
    """Product with a forward operator, or its adjoint; differentiable any number of times."""

    @staticmethod
    def forward(ctx: Any, operator: ForwardOperator, adjoint: bool, values: Tensor) -> Tensor:
        """Compute the product."""
        ctx.operator, ctx.adjoint = operator, adjoint
        product, own = (
            (operator.backward, operator.trace_shape) if adjoint else (operator.forward, operator.volume_shape)
        )
        return _each(product, values, len(own))

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Any, ...]:
        """Compute the gradient of the values, by the transpose."""
        return None, None, apply(Product, ctx.operator, not ctx.adjoint, gradient)


class ParametricProduct(torch.autograd.Function):
    """Product with a parametric transform, or its transpose; differentiable in its parameters once."""

    @staticmethod
    def forward(
        ctx: Any, transform: ParametricTransform, adjoint: bool, values: Tensor, positions: Tensor | None,
        sound_speed: Parameter, time_zero: Parameter,
    ) -> Tensor:  # fmt: skip
        """Compute the product at the parameters."""
        ctx.transform, ctx.adjoint = transform, adjoint
        given = positions, sound_speed, time_zero
        ctx.numbers = [None if isinstance(each, Tensor) else each for each in given]
        ctx.save_for_backward(values, *(each if isinstance(each, Tensor) else None for each in given))
        at = _placed(transform, positions, sound_speed, time_zero)
        own = transform.trace_shape if adjoint else transform.volume_shape
        return _each(at.to_image if adjoint else at.to_traces, values, len(own))

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Any, ...]:
        """Compute the gradients of values and parameters."""
        values, *tensors = ctx.saved_tensors
        parameters = [n if t is None else t for n, t in zip(ctx.numbers, tensors, strict=True)]
        needed = ctx.needs_input_grad
        of_values = None
        if needed[2]:
            of_values = apply(ParametricProduct, ctx.transform, not ctx.adjoint, gradient, *parameters)
        of_parameters: tuple[Tensor | None, ...] = (None, None, None)
        if any(needed[3:]):
            image, traces = (gradient, values) if ctx.adjoint else (values, gradient)
            of_parameters = ParameterGradient.apply(ctx.transform, image, traces, needed[3:], *parameters)
        return None, None, of_values, *of_parameters


class ParameterGradient(torch.autograd.Function):
    """Gradient of ⟨g, K(θ) f⟩ by the parameters θ; not differentiable itself."""

    @staticmethod
    def forward(
        ctx: Any, transform: ParametricTransform, image: Tensor, traces: Tensor, needed: tuple[bool, ...],
        *parameters: Any,
    ) -> tuple[Tensor | None, ...]:  # fmt: skip
        """Compute the gradients, summed over the batch."""
        at, axes = _placed(transform, *parameters), len(transform.volume_shape)
        images = image.detach().reshape(-1, *image.shape[image.dim() - axes :])
        lines = traces.detach().reshape(-1, *transform.trace_shape)
        sums: list[Any] = [0.0, 0.0, 0.0]
        for f, g in zip(images, lines, strict=True):
            given, of_time = _as_array(f), None
            if needed[0]:
                sums[0] = sums[0] + (_as_tensor(at.positions_to_traces(given), g) * g).sum(-1).T
            if needed[2] or (needed[1] and not transform.variation.quotient):
                of_time = at.time_to_traces(given)
            if needed[1]:
                sums[1] = sums[1] + (_as_tensor(at.speeds_to_traces(given, of_time), g) * g).sum((-2, -1))
            if needed[2]:
                sums[2] = sums[2] + (_as_tensor(of_time, g) * g).sum()
        return tuple(
            found.to(given).reshape(given.shape) if wanted else None
            for found, given, wanted in zip(sums, parameters, needed, strict=True)
        )

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Any, ...]:
        """Raise an error: second derivatives by parameters are not available."""
        raise NotImplementedError("second derivatives by positions, sound speed or time zero")


class AttenuationMatrix(torch.autograd.Function):
    """Attenuation matrix (N_t, N_t) of a model in float64, as a function of sound speed and time zero."""

    @staticmethod
    def forward(ctx: Any, model: DifferentiableModel, sound_speed: Parameter, time_zero: Parameter) -> Tensor:
        """Compute the matrix."""
        given = sound_speed, time_zero
        ctx.model, ctx.parameters = model, [_number(name, v) for name, v in zip(_NAMES, given, strict=True)]
        ctx.like = [each.detach() if isinstance(each, Tensor) else None for each in given]
        return torch.from_numpy(model.attenuation(*ctx.parameters))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Any, ...]:
        """Compute the gradients of both."""
        derivatives = ctx.model.attenuation_derivatives(*ctx.parameters)
        sums = [(gradient.cpu() * torch.from_numpy(each)).sum() for each in derivatives]
        needed = ctx.needs_input_grad[1:]
        return None, *(
            one.to(like).reshape(like.shape) if wanted else None
            for one, like, wanted in zip(sums, ctx.like, needed, strict=True)
        )


_NAMES = "sound_speed", "time_zero"


def _placed(transform: ParametricTransform, positions: Any, sound_speed: Any, time_zero: Any) -> TransformAt:
    if not isinstance(positions, Tensor | None):
        raise InvalidInput("positions", type(positions).__name__, "a tensor, or None")
    x = None if positions is None else positions.detach().cpu().double().numpy()
    speed = sound_speed.detach().cpu().double().numpy() if isinstance(sound_speed, Tensor) else sound_speed
    if not isinstance(speed, float | int | np.ndarray | None):
        raise InvalidInput("sound_speed", type(speed).__name__, "a tensor, a number, or None")
    return transform.at(transform.parameters(x, speed, _number("time_zero", time_zero)))


def _number(name: str, value: Parameter) -> float | None:
    if value is None:
        return None
    if isinstance(value, Tensor) and value.numel() != 1:
        raise InvalidInput(name, f"a tensor of {value.numel()} numbers", "one number")
    return float(value)
