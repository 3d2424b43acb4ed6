"""FISTA with adaptive restart, for all regularisers except thresholding.

    minimise over f (≥ 0):  ½‖A f − g‖² + λ·R(f)

From few sensors the direct formula leaves the streaks of each one all over the volume; what is non-negative, and flat
or sparse, cannot hold them.
"""

from __future__ import annotations

import numpy as np

from steradian.imaging.engines.array_namespace import like
from steradian.imaging.iterative.base import IterativeSolver
from steradian.imaging.iterative.proximal import proximal
from steradian.imaging.volume import RealArray

_POWER_STEPS = 6
_SAFETY = 1.1  # of the largest singular value found by so many power steps


class Fista(IterativeSolver):
    """FISTA solver (Beck and Teboulle 2009) with the restart of O'Donoghue and Candès (2015)."""

    def run(self, start: RealArray | None = None) -> RealArray:
        """Run FISTA from an image (None: zero) until a stopping rule applies and return the image."""
        back = self._adjoint(self._data)
        norm = float(np.linalg.norm(self._data)) or 1.0
        curvature = self._curvature(back)
        minimised = proximal(
            self._options.regularisation,
            non_negative=self._options.non_negative,
            shape=self._model.volume_shape,
            spacing=self._model.geometry.spacing,
            threads=self._model.threads,
        )
        weight = self._options.lambda_()
        weight *= curvature if self._options.regularisation == "tikhonov" else float(np.abs(back).max())
        kind = back.dtype.type
        image, point, new = np.zeros_like(back), np.zeros_like(back), np.empty_like(back)
        if start is not None:
            image, _ = self._scaled(start)
            point[...] = image
        momentum = 1.0
        for iteration in range(self._options.iterations):
            self._look()
            if iteration or start is not None:
                residual = self._forward(point)
                residual -= self._data
                back = self._adjoint(residual)
            else:
                residual, back = -self._data, -back
            size = float(np.linalg.norm(residual))
            self.residuals.append(size / norm)
            limit = self._options.discrepancy
            if limit is not None and iteration and size <= limit * self._noise:
                self.stopped = "discrepancy"
                break
            back *= kind(-1 / curvature)
            back += point
            minimised(back, new, weight / curvature)
            new[..., : self._support.start] = 0
            new[..., self._support.stop :] = 0
            self.done = iteration + 1
            np.subtract(point, new, out=point)
            np.subtract(new, image, out=image)  # the step
            change, total = float(np.linalg.norm(image)), float(np.linalg.norm(new))
            following = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
            ahead = (momentum - 1) / following
            if np.vdot(point, image) > 0:  # uphill: start anew without momentum
                following, ahead = 1.0, 0.0
            np.multiply(image, kind(ahead), out=point)
            point += new
            image, new = new, image
            momentum = following
            if change <= self._options.change * total:
                self.stopped = "change"
                break
        self._look()
        return image

    def _curvature(self, start: RealArray) -> float:
        """Return an upper estimate of A's largest squared singular value (Lipschitz constant), by power iteration."""
        noise = like(np.random.default_rng(0).standard_normal(start.shape, start.dtype), start)
        vector: RealArray = start + start.dtype.type(1e-3 * float(np.abs(start).max())) * noise
        value = 1.0
        for _ in range(_POWER_STEPS):
            vector /= float(np.linalg.norm(vector)) or 1.0
            vector = self._adjoint(self._forward(vector))
            value = float(np.linalg.norm(vector))
        return _SAFETY * (value or 1.0)

    def _adjoint(self, traces: RealArray) -> RealArray:
        self.products += 1
        return self._model.backward(traces, cancelled=self._cancelled)
