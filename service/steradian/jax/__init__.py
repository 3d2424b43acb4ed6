"""JAX operators: forward model, adjoint and direct reconstruction as differentiable functions of arrays.

    import steradian, steradian.jax

    operator = steradian.jax.ForwardOperator(geometry, grid)
    traces = operator(image)                                # (…, x, y, z) → (…, M, N_t)
    gradient = jax.grad(lambda x: ((operator(image, positions=x) - measured) ** 2).sum())(positions)

Products are computed on the host by callbacks and may be compiled (``jax.jit``). They are differentiable forwards and
backwards by image and A-lines any number of times, and once by sensor positions, sound speed and time zero, with the
derivatives of :mod:`steradian.imaging.parametric`. Arrays may have any leading batch axes; ``jax.vmap`` is not
supported. Requires JAX (extra ``jax``).
"""

from __future__ import annotations

from steradian.jax.operators import DirectReconstruction, ForwardOperator

__all__ = ["DirectReconstruction", "ForwardOperator"]
