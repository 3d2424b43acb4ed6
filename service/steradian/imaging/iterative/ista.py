"""Iterative soft thresholding preconditioned with the direct inverse.

    f ← f + s·(T(f + B(g − A f)) − f),   A the model, B the direct reconstruction, T soft thresholding

It begins with f = 0, so that the first step is the direct image. From few sensors B A maps an object to itself, as far
as the aperture sees it, and to streaks that are spread over the volume like noise. What of a step does not rise above
them is therefore set to zero, and the more of the object is found, the lower they are. How high they are at each depth
is measured anew for each step, in two ways, of which the lower counts:

- the median of the step's absolute values, as in approximate message passing (Donoho, Maleki and Montanari 2009):
  right where the object leaves most voxels empty;
- the root mean square of B of the same traces with a random sign for each sensor: streaks and noise are as strong as
  before, and the object, which is where all sensors agree, is gone. It is right for objects that fill the volume, too.

B stands where a plain gradient has Aᵀ: it undoes the density of the sensors and the loss of steep waves, so that a
handful of steps suffice. Each is as long as makes the misfit least, so none makes it larger.

Thresholds lower amplitudes. At the end the image is scaled to the data, which adds no noise to it, and the voxels that
were found are fitted once more without thresholds, until only noise is left of the misfit.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.imaging.engines.array_namespace import iter_rows, like, to_numpy
from steradian.imaging.iterative.base import IterativeSolver
from steradian.imaging.plan import ReconstructionPlan
from steradian.imaging.volume import RealArray, Volume

_NORMAL = 1.4826  # standard deviation of normally distributed values over the median of their absolute values
MIN_STEP, _LONGEST = 1 / 16, 2.0  # step; a shorter one would not change what is seen
MIN_GAIN = 0.05  # share of the misfit beyond the noise that a step has to take away for another one to follow
_SMOOTH = np.array([1, 2, 3, 2, 1]) / 9  # over depths


class IterativeSoftThresholding(IterativeSolver):
    """ISTA solver preconditioned with the direct inverse B on the model's sensors and voxels."""

    def __init__(self, direct: ReconstructionPlan, *others: Any) -> None:
        super().__init__(*others)
        self._direct = direct
        discrepancy = self._options.discrepancy
        self._enough = 0.0 if discrepancy is None else discrepancy * self._noise
        self._signs = np.random.default_rng(0)
        self._norm = _norm(self._data) or 1.0
        self.residuals.append(_norm(self._data) / self._norm)

    def run(self) -> RealArray:
        """Run iterative soft thresholding until a stopping rule applies and return the image."""
        image: RealArray = np.zeros(self._model.volume_shape, self._data.dtype, like=self._data)
        residual = self._data.copy()
        while self.done < self._options.iterations:
            self._look()
            new = self._step(image, residual)
            self.done += 1
            after = self._misfit(new)
            np.subtract(residual, after, out=after)  # what the step explains
            length = min(_optimal_step(residual, after), _LONGEST)
            if length < MIN_STEP:
                self.stopped = "misfit"
                break
            change = self._take(length, image, new, residual, after)
            before, last = self.residuals[-2:]
            if last * self._norm <= self._enough:
                self.stopped = "discrepancy"
                break
            if change <= self._options.change * _norm(image):
                self.stopped = "change"
                break
            if self.done > 1 and self._beyond(last) > (1 - MIN_GAIN) * self._beyond(before):
                self.stopped = "misfit"
                break
        return self._refitted(image, residual)

    def _step(self, image: RealArray, residual: RealArray) -> RealArray:
        """Return the image after one ISTA step: soft threshold of image plus back-projected residual."""
        signs = like(self._signs.choice(np.array([-1, 1], residual.dtype), len(residual)), residual)
        streaks = rms_per_depth(self._back(residual * signs[:, None]))
        new = self._back(residual)
        cut = self._options.lambda_() * np.minimum(noise_level(new), streaks)
        new += image
        soft_threshold(new, like(cut.astype(new.dtype), new), non_negative=self._options.non_negative)
        return new

    def _refitted(self, image: RealArray, residual: RealArray) -> RealArray:
        """Scale the image to the data and refit its non-zero voxels, without fitting the noise."""
        if self._options.non_negative and image.min() < 0:  # steps longer than 1 go beyond
            np.maximum(image, 0, out=image)
            residual = self._misfit(image)
        found = image != 0
        for refit in range(self._options.refits):
            self._look()
            new: RealArray
            explained: RealArray
            if refit == 0:
                new, explained = image + image, self._data - residual
            else:
                new = self._back(residual)
                new *= found
                explained = self._forward(new)
                new += image
            length = self._no_further(_optimal_step(residual, explained), residual, explained)
            if length <= 0:
                break
            self._take(length, image, new, residual, explained)
        if self._options.non_negative:
            np.maximum(image, 0, out=image)
        self._look()
        return image

    def _no_further(self, length: float, residual: RealArray, explained: RealArray) -> float:
        """Return the step length at which the residual equals the noise, if shorter than the optimal step."""
        size, left = _norm(explained), _norm(residual)
        if left <= 1.001 * self._enough or length <= 0:  # rounded, just there
            return 0.0
        return length - float(np.sqrt(max(0.0, length**2 - (left**2 - self._enough**2) / size**2)))

    def _take(
        self, length: float, image: RealArray, new: RealArray, residual: RealArray, explained: RealArray
    ) -> float:
        """Move image and residual by a step towards ``new``, in place; return the norm of the change."""
        factor = image.dtype.type(length)
        new -= image
        new *= factor
        image += new
        explained *= factor
        residual -= explained
        self.residuals.append(_norm(residual) / self._norm)
        return _norm(new)

    def _beyond(self, misfit: float) -> float:
        """Return the norm of the residual in excess of the noise."""
        return float(np.sqrt(max(0.0, (misfit * self._norm) ** 2 - self._noise**2)))

    def _misfit(self, image: RealArray) -> RealArray:
        residual = self._forward(image)
        return np.subtract(self._data, residual, out=residual)

    def _back(self, traces: RealArray) -> RealArray:
        self.products += 1
        volume = self._direct.run(traces, cancelled=self._cancelled)
        assert isinstance(volume, Volume)  # noqa: S101 - of one set of traces
        return volume.values


def noise_level(values: RealArray) -> NDArray[np.float64]:
    """Estimate the standard deviation of streaks at each depth, shape (Nz,), from the median of absolute values."""
    lateral = tuple(range(values.ndim - 1))
    thinned = values[(slice(None, None, 2),) * len(lateral)]
    return _smooth(_NORMAL * to_numpy(np.median(np.abs(thinned), axis=lateral)))


def rms_per_depth(values: RealArray) -> NDArray[np.float64]:
    """Return the root mean square of the image at each depth, shape (Nz,)."""
    squares = sum(
        to_numpy(np.einsum("...z,...z->...z", part, part).reshape(-1, part.shape[-1]).sum(axis=0))
        for part in iter_rows(values)
    )
    return _smooth(np.sqrt(squares / np.prod(values.shape[:-1])))


def soft_threshold(values: RealArray, cut: RealArray, *, non_negative: bool) -> None:
    """Apply soft thresholding in place, row by row to save memory."""
    for part in iter_rows(values):
        part -= cut if non_negative else np.clip(part, -cut, cut)
        if non_negative:
            np.maximum(part, 0, out=part)


def _smooth(levels: RealArray) -> NDArray[np.float64]:
    return np.convolve(np.pad(levels, len(_SMOOTH) // 2, mode="edge"), _SMOOTH, "valid")


def _optimal_step(residual: RealArray, explained: RealArray) -> float:
    """Return the step length that minimises the residual; 0 if the step explains nothing."""
    size = float(np.vdot(explained, explained))
    return float(np.vdot(residual, explained)) / size if size > 0 else 0.0


def _norm(values: RealArray) -> float:
    return float(np.linalg.norm(values))
