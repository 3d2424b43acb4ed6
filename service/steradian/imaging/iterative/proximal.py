"""Proximal operators of the regularisers.

Each regulariser R has ``step(u, x, length)``: x becomes the minimiser of ½‖x − u‖² + length·R(x), over x ≥ 0 where
asked. Total variation is isotropic, in units of the finest voxel side; its dual variables stay from one call to the
next, so that a few projected gradient steps (Chambolle's, with the constraint as by Beck and Teboulle 2009) suffice.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from steradian.imaging.compute import thread_pool as workers
from steradian.imaging.engines.array_namespace import is_gpu_array
from steradian.imaging.iterative_options import Regularisation
from steradian.imaging.volume import RealArray

Proximal: TypeAlias = Callable[[RealArray, RealArray, float], None]
_INNER = 4  # dual steps a call
_ROWS = 4  # rows along x a piece of work has


def proximal(
    kind: Regularisation, *, non_negative: bool, shape: tuple[int, ...], spacing: tuple[float, ...], threads: int
) -> Proximal:
    """Return a regulariser's proximal operator for an image shape; ``step(u, x, length)`` writes x, may change u."""
    if kind == "total-variation":
        return _TotalVariation(non_negative, shape, spacing, threads)

    def step(u: RealArray, x: RealArray, length: float) -> None:
        if kind == "tikhonov":
            np.multiply(u, u.dtype.type(1 / (1 + length)), out=x)
        elif kind == "sparsity" and not non_negative:
            np.clip(u, -length, length, out=x)
            np.subtract(u, x, out=x)
        else:
            np.subtract(u, u.dtype.type(length if kind == "sparsity" else 0.0), out=x)
        if non_negative:
            np.maximum(x, 0, out=x)

    return step


class _TotalVariation:
    """Proximal operator of total variation, by its dual problem."""

    def __init__(self, non_negative: bool, shape: tuple[int, ...], spacing: tuple[float, ...], threads: int) -> None:
        self._shape = (shape[0], shape[1] if len(shape) == 3 else 1, shape[-1])
        finest = min(spacing)
        sides = (spacing[0], spacing[1] if len(shape) == 3 else finest, spacing[-1])
        self._rates = tuple(finest / s for s in sides)
        self._non_negative = non_negative
        self._threads = threads
        self._dual: NDArray[Any] | None = None

    def __call__(self, u: RealArray, x: RealArray, length: float) -> None:
        u, x = u.reshape(self._shape), x.reshape(self._shape)
        if self._dual is None:
            self._dual = np.zeros((3, *self._shape), u.dtype, like=u)
        if is_gpu_array(u):
            self._by_arrays(u, x, length)
            return
        from steradian.imaging.iterative.tv_kernels import dual_step, primal_step

        dual, kind = self._dual, u.dtype.type
        rates = np.array(self._rates, u.dtype)
        # the kernels are compiled for finite numbers: no bound is the least of them
        scale, low = kind(length), kind(0) if self._non_negative else np.finfo(kind).min
        rate = kind(1 / (max(length, 1e-30) * 4 * float((rates**2).sum())))
        pieces = -(-self._shape[0] // _ROWS)

        def descend(piece: int, _: None, flag: NDArray[np.uint8]) -> None:
            primal_step(u, dual, x, piece * _ROWS, min((piece + 1) * _ROWS, len(u)), scale, rates, low)

        def climb(piece: int, _: None, flag: NDArray[np.uint8]) -> None:
            dual_step(x, dual, piece * _ROWS, min((piece + 1) * _ROWS, len(u)), rate, rates)

        how: dict[str, Any] = {"threads": self._threads, "progress": None, "cancelled": None}
        for _ in range(_INNER):
            workers.parallel_for("regularisation", pieces, lambda: None, descend, **how)
            workers.parallel_for("regularisation", pieces, lambda: None, climb, **how)
        workers.parallel_for("regularisation", pieces, lambda: None, descend, **how)

    def _by_arrays(self, u: RealArray, x: RealArray, length: float) -> None:
        """Compute the proximal operator with whole-array operations for a GPU (:mod:`.tv_kernels` on the CPU)."""
        dual, kind = self._dual, u.dtype.type
        assert dual is not None  # noqa: S101
        rate = 1 / (max(length, 1e-30) * 4 * float(np.sum(np.square(self._rates))))

        def later(axis: int) -> tuple[slice, ...]:
            return (slice(None),) * axis + (slice(1, None),)

        def earlier(axis: int) -> tuple[slice, ...]:
            return (slice(None),) * axis + (slice(None, -1),)

        def descend() -> None:
            x[...] = u
            for axis, step in enumerate(self._rates):
                part = dual[axis] * kind(length * step)
                np.add(x, part, out=x)
                x[later(axis)] -= part[earlier(axis)]
            if self._non_negative:
                np.maximum(x, 0, out=x)

        def climb() -> None:
            for axis, step in enumerate(self._rates):
                dual[axis][earlier(axis)] += kind(rate * step) * (x[later(axis)] - x[earlier(axis)])
            size = np.sqrt(dual[0] * dual[0] + dual[1] * dual[1] + dual[2] * dual[2])
            np.maximum(size, 1, out=size)
            np.divide(dual, size, out=dual)

        for _ in range(_INNER):
            descend()
            climb()
        descend()
