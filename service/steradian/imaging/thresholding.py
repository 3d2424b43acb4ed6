"""Iterative thresholding: the direct reconstruction of what is not explained yet is added, and its streaks cut off.

    f ← T(f + s·B(g − A f)),   A the model, B the direct reconstruction, T soft thresholding

From few sensors B A maps an object to itself, as far as the aperture sees it, and to streaks that are spread over the
volume like noise. What of the step does not rise above them is therefore set to zero, and the more of the object is
found, the lower they are: each threshold follows the median of the step's own absolute values, depth by depth, as in
approximate message passing (Donoho, Maleki and Montanari 2009). B stands where a plain gradient has Aᵀ: it undoes the
density of the sensors and the loss of steep waves, so that a step of 1 is right and a handful of steps suffice. A step
that makes the misfit larger is not taken, and the next ones are half as long.

Thresholds lower amplitudes. At the end the voxels that were found are fitted once more without any.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from steradian.errors import Cancelled
from steradian.imaging.iterative_options import Iterative
from steradian.imaging.operators import ForwardOperator
from steradian.imaging.plan import ReconstructionPlan
from steradian.imaging.volume import RealArray, Volume
from steradian.progress import IsCancelled, Progress

Stopped = Literal["discrepancy", "change", "misfit", "iterations"]

_NORMAL = 1.4826  # standard deviation of normally distributed values over the median of their absolute values
_SHORTEST = 1 / 16  # step; shorter ones would not change what is seen
_PAYS = 0.03  # share of the misfit that a step has to take away for another one to follow
_SMOOTH = np.array([1, 2, 3, 2, 1]) / 9  # over depths


class Thresholding:
    """One run.

    Parameters
    ----------
    direct
        B, of the model's sensors and voxels.
    model
        A.
    measured
        g, the A-lines.
    options
        Thresholds and stopping rule.
    noise
        Norm of the noise in ``measured``.
    """

    def __init__(
        self,
        direct: ReconstructionPlan,
        model: ForwardOperator,
        measured: RealArray,
        options: Iterative,
        noise: float,
        progress: Progress | None,
        cancelled: IsCancelled | None,
    ) -> None:
        self._direct, self._model, self._data, self._options = direct, model, measured, options
        self._enough = 0.0 if options.discrepancy is None else options.discrepancy * noise
        self._progress, self._cancelled = progress, cancelled
        self._norm = float(np.linalg.norm(measured)) or 1.0
        self.residuals: list[float] = []
        self.products = self.done = 0
        self.stopped: Stopped = "iterations"

    def run(self) -> RealArray:
        """Return the image."""
        strength, step = self._options.weight(), 1.0
        image: RealArray | None = None
        back, last = self._back(self._data), self._norm
        while self.done < self._options.iterations:
            self._look()
            cut = (strength * step * level(back)).astype(back.dtype)
            new = self._shrunk(_ahead(image, back, step), cut)
            residual = self._misfit(new)
            size = float(np.linalg.norm(residual))
            self.done += 1
            if size > last:
                step /= 2
                if step < _SHORTEST:
                    self.stopped = "misfit"
                    break
                continue
            self.residuals.append(size / self._norm)
            change = float(np.linalg.norm(new if image is None else new - image))
            image, before, last = new, last, size
            if size <= self._enough:
                self.stopped = "discrepancy"
                break
            if change <= self._options.change * float(np.linalg.norm(new)):
                self.stopped = "change"
                break
            if len(self.residuals) > 1 and size > (1 - _PAYS) * before:
                self.stopped = "misfit"
                break
            back = self._back(residual)
        if image is None:
            return np.zeros_like(back)
        return self._refitted(image, last)

    def _refitted(self, image: RealArray, last: float) -> RealArray:
        """Fit the voxels that are not zero without thresholds, as long as the misfit falls and is not noise."""
        found = image != 0
        for _ in range(self._options.refits):
            self._look()
            if last <= self._enough:
                break
            new = _ahead(image, self._back(self._misfit(image)), 1.0)
            new *= found
            if self._options.non_negative:
                np.maximum(new, 0, out=new)
            size = float(np.linalg.norm(self._misfit(new)))
            if size > last:
                break
            self.residuals.append(size / self._norm)
            image, last = new, size
        self._look()
        return image

    def _shrunk(self, values: RealArray, cut: RealArray) -> RealArray:
        if not self._options.non_negative:
            return values - np.clip(values, -cut, cut)
        values -= cut
        return np.maximum(values, 0, out=values)

    def _misfit(self, image: RealArray) -> RealArray:
        self.products += 1
        return self._data - self._model.forward(image, cancelled=self._cancelled)

    def _back(self, traces: RealArray) -> RealArray:
        self.products += 1
        volume = self._direct.run(traces, cancelled=self._cancelled)
        assert isinstance(volume, Volume)  # noqa: S101 - of one set of traces
        return volume.values

    def _look(self) -> None:
        if self._progress is not None:
            misfit = f", misfit {100 * self.residuals[-1]:.1f} %" if self.residuals else ""
            self._progress(f"iterations{misfit}", self.done, self._options.iterations)
        if self._cancelled is not None and self._cancelled():
            raise Cancelled("cancelled during: iterations")


def level(values: RealArray) -> RealArray:
    """Estimate the standard deviation of streaks at each depth, shape (Nz,), from the median of absolute values."""
    lateral = tuple(range(values.ndim - 1))
    thinned = values[(slice(None, None, 2),) * len(lateral)]
    found = _NORMAL * np.median(np.abs(thinned), axis=lateral)
    wide = np.pad(found, len(_SMOOTH) // 2, mode="edge")
    smooth: RealArray = np.convolve(wide, _SMOOTH, "valid")
    return smooth


def _ahead(image: RealArray | None, back: RealArray, step: float) -> RealArray:
    ahead: RealArray = back * back.dtype.type(step)
    if image is not None:
        ahead += image
    return ahead
