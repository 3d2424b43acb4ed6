"""deepinv physics: planar photoacoustic measurement as a :class:`deepinv.physics.LinearPhysics`.

    physics = steradian.deepinv.PlanarPhotoacoustics(geometry, grid, noise_model=deepinv.physics.GaussianNoise(0.01))
    y = physics(x)                       # x (B, 1, X, Y, Z) → y (B, 1, M, N_t)
    physics.A_adjoint(y), physics.A_dagger(y)

Requires deepinv (extra ``deepinv``).
"""

from __future__ import annotations

from typing import Any

import deepinv
import numpy as np
import torch

from steradian.core.exceptions import InvalidInput
from steradian.imaging.acquisition import AcquisitionGeometry
from steradian.imaging.options import Compute, ImageGrid, Nufft
from steradian.torch import DirectReconstruction, ForwardOperator

__all__ = ["PlanarPhotoacoustics"]


class PlanarPhotoacoustics(deepinv.physics.LinearPhysics):
    """Linear physics of a planar photoacoustic scan: A is the forward operator, A_dagger the direct reconstruction.

    Images have the shape (B, C, X, Y, Z), (B, C, X, Z) in 2-D, and measurements (B, C, M, N_t); channels are
    independent, for instance wavelengths.

    Parameters
    ----------
    geometry, grid, compute
        As in :class:`steradian.ForwardOperator`; the image of a direct reconstruction must have the grid's depths.
    tolerance
        Relative error of the forward operator and of the direct reconstruction.
    normalise
        Divide the operator by its largest singular value, as deepinv's algorithms with a step size of 1 assume. A
        measurement is then that of the scanner divided by :attr:`norm`.
    noise_model, **more
        As in :class:`deepinv.physics.LinearPhysics`.

    Attributes
    ----------
    norm
        Divisor of the forward operator; 1 without ``normalise``.

    Raises
    ------
    InvalidInput
        If a parameter is out of range.
    """

    def __init__(
        self,
        geometry: AcquisitionGeometry,
        grid: ImageGrid,
        *,
        tolerance: float = 1e-4,
        normalise: bool = False,
        compute: Compute = Compute(),
        **more: Any,
    ) -> None:
        self._forward = ForwardOperator(geometry, grid, tolerance=tolerance, compute=compute)
        self._inverse: DirectReconstruction | None = None
        self._settings = geometry, grid, Nufft(tolerance=tolerance), compute
        self.norm = _largest_singular_value(self._forward) if normalise else 1.0
        super().__init__(img_size=(1, *self._forward.volume_shape), **more)

    def A(self, x: torch.Tensor, **_: Any) -> torch.Tensor:  # noqa: N802
        """Return the measurements (B, C, M, N_t) of images (B, C, X, Y, Z)."""
        return self._forward(x) / self.norm

    def A_adjoint(self, y: torch.Tensor, **_: Any) -> torch.Tensor:  # noqa: N802
        """Return the adjoint (B, C, X, Y, Z) of measurements (B, C, M, N_t)."""
        return self._forward.adjoint(y) / self.norm

    def A_dagger(self, y: torch.Tensor, **_: Any) -> torch.Tensor:  # noqa: N802
        """Return the direct reconstruction (paper, equation 7), an approximate pseudo-inverse."""
        if self._inverse is None:
            geometry, grid, method, compute = self._settings
            inverse = DirectReconstruction(geometry, grid, method, compute=compute)
            if inverse.volume_shape != self._forward.volume_shape:
                shape = inverse.volume_shape
                raise InvalidInput(
                    "depth", grid.depth, f"slices that both have; the direct image has the shape {shape}"
                )
            self._inverse = inverse
        return self._inverse(y * self.norm)


def _largest_singular_value(operator: ForwardOperator) -> float:
    """Return the largest singular value, to 0.1 %, by Lanczos iterations from a fixed start."""
    from scipy.sparse.linalg import svds

    plain = operator.plain("float32")
    start = np.random.default_rng(0).standard_normal(min(plain.shape)).astype(np.float32)
    found: Any = svds(plain, k=1, tol=1e-3, v0=start, return_singular_vectors=False)
    return float(found[0])
