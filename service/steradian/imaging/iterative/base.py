"""Base class of the iterative solvers: counters, stopping rules and progress."""

from __future__ import annotations

from typing import Literal

import numpy as np

from steradian.core.exceptions import Cancelled
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging.iterative_options import IterativeOptions
from steradian.imaging.operators import ForwardOperator
from steradian.imaging.volume import RealArray

StopReason = Literal["discrepancy", "change", "misfit", "iterations"]


class IterativeSolver:
    """Base class of a single run of an iterative solver: operator, data, stopping rules, progress.

    Parameters
    ----------
    model
        A.
    measured
        g, the A-lines.
    options
        Regulariser and stopping rule.
    noise
        Norm of the noise in ``measured``.
    progress, cancelled
        See :mod:`steradian.core.progress`.
    support
        Depth slices of the model that can hold sources; the others stay zero.
    """

    def __init__(
        self,
        model: ForwardOperator,
        measured: RealArray,
        options: IterativeOptions,
        noise: float,
        progress: Progress | None,
        cancelled: CancelCheck | None,
        support: slice = slice(None),
    ) -> None:
        self._model, self._data, self._options, self._noise = model, measured, options, noise
        self._applied = model  # in products
        self._progress, self._cancelled = progress, cancelled
        self._support = slice(*support.indices(model.volume_shape[-1]))
        self.residuals: list[float] = []
        self.products = self.done = 0
        self.stopped: StopReason = "iterations"

    def run(self, start: RealArray | None = None) -> RealArray:
        """Iterate from an image, scaled to the data (None: zero), until a stopping rule applies; return the image."""
        raise NotImplementedError

    def _scaled(self, start: RealArray) -> tuple[RealArray, RealArray]:
        """Return a start image scaled to explain most of the data, and the A-lines that it explains."""
        explained = self._forward(start)
        size = float(np.vdot(explained, explained))
        factor = start.dtype.type(max(0.0, float(np.vdot(self._data, explained)) / size) if size > 0 else 0.0)
        return start * factor, explained * factor

    def _forward(self, image: RealArray) -> RealArray:
        self.products += 1
        return self._applied.forward(image, cancelled=self._cancelled)

    def _look(self) -> None:
        if self._progress is not None:
            misfit = f", misfit {100 * self.residuals[-1]:.1f} %" if self.done else ""
            self._progress(f"iterations{misfit}", self.done, self._options.iterations)
        if self._cancelled is not None and self._cancelled():
            raise Cancelled("cancelled during: iterations")
