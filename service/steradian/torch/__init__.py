"""PyTorch operators: forward model, adjoint and direct reconstruction as differentiable functions of tensors.

    import steradian, steradian.torch

    operator = steradian.torch.ForwardOperator(geometry, grid)
    traces = operator(image)                                # (…, x, y, z) → (…, M, N_t)
    loss = (operator(image, positions=positions) - measured).square().sum()
    loss.backward()                                         # gradients of image and positions

Gradients are those of the operators themselves: the adjoint for images and A-lines, and for sensor positions, sound
speed and time zero the derivatives of :mod:`steradian.imaging.parametric`. Tensors may have any leading batch
axes, and are of float32 or float64, in memory or, with ``Compute(device="gpu")``, on a CUDA device. Requires PyTorch
(extra ``torch``).
"""

from __future__ import annotations

from steradian.torch.operators import DirectReconstruction, ForwardOperator

__all__ = ["DirectReconstruction", "ForwardOperator"]
