"""Iterative thresholding preconditioned with the direct inverse.

    d = T(f + B(g − A f)) − f,   f ← f + a·d + b·p,   p the step before

A is the model, B the direct reconstruction, T a thresholding rule. It begins with f = 0, so that the first step is the
direct image. From few sensors B A maps an object to itself, as far as the aperture sees it, and to streaks that are
spread over the volume like noise. What of f + B(g − A f) does not rise above them is therefore set to zero, and the
more of the object is found, the lower they are. How high they are at each depth is measured anew for each step, in two
ways, of which the lower counts:

- the median of the step's absolute values, as in approximate message passing (Donoho, Maleki and Montanari 2009):
  right where the object leaves most voxels empty;
- the root mean square of B of the same traces with a random sign for each sensor: streaks and noise are as strong as
  before, and the object, which is where all sensors agree, is gone. It is right for objects that fill the volume, too.

An object that fills the volume raises these levels, and little of it rises above them. Where the iteration would end
with much of the data unexplained, the threshold, which is so many standard deviations of the streaks, is lowered.

T(v) = v·(1 − (c/|v|)^1.5) beyond the threshold c, and 0 below. It is between soft thresholding (exponent 1), which
lowers all amplitudes by c, and the non-negative garrote (exponent 2, Breiman 1995; Gao 1998), which leaves more noise.

B stands where a plain gradient has Aᵀ: it undoes the density of the sensors and the loss of steep waves, so that a
handful of steps suffice. The lengths a and b are half-way from where the misfit is least along d to where it is least
over the plane of both directions (sequential subspace optimisation, Narkiss and Zibulevsky 2005), whose A-lines are
known: all of the way saves no more steps, and fits more of the noise.

The steps can use a model with less lateral padding, in which the last part of some A-lines contains sound of the
volume's periodic copies. The misfit is then computed once more with the model itself. At the end the voxels that were
found are fitted once more without thresholds, until only noise is left of the misfit, and the image is scaled such that
its A-lines have the energy of the data without their noise, which adds no noise to it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.imaging.engines.array_namespace import iter_rows, like, to_numpy
from steradian.imaging.iterative.base import IterativeSolver
from steradian.imaging.operators import ForwardOperator
from steradian.imaging.plan import ReconstructionPlan
from steradian.imaging.volume import RealArray, Volume

_NORMAL = 1.4826  # standard deviation of normally distributed values over the median of their absolute values
MIN_STEP, _LONGEST = 1 / 16, 2.0  # step; a shorter one would not change what is seen
DAMPING = 0.5  # share of the way from the least misfit of a step to that of the step and the one before
MIN_GAIN = 0.05  # share of the misfit beyond the noise that a step has to take away for another one to follow
MIN_LAST_GAIN = 0.15  # the same where little is left:
LITTLE_LEFT = 0.15  # less than this share of the data beyond the noise, and less than the noise
MAX_UNEXPLAINED = 0.25  # share of the data beyond the noise with which the iteration does not end before
MIN_STRENGTH, LOWERED = 2.0, 2 / 3  # the threshold was lowered, each time to that share, to that many deviations
MAX_SCALE = 1.1  # of the amplitudes at the end: more is missing where the model is wrong
WARM_MISFIT = 0.45  # beyond the noise, above which a start image is of another object and not used
_ENOUGH_VALUES = 3000  # of a depth for its median
_SMOOTH = np.array([1, 2, 3, 2, 1]) / 9  # over depths


class IterativeThresholding(IterativeSolver):
    """Thresholding solver preconditioned with the direct inverse B on the model's sensors and voxels.

    Parameters
    ----------
    direct
        B.
    others
        Parameters of :class:`IterativeSolver`.
    rough
        Model of the steps; None: the model itself.
    """

    def __init__(self, direct: ReconstructionPlan, *others: Any, rough: ForwardOperator | None = None) -> None:
        super().__init__(*others)
        self._direct, self._applied = direct, rough or self._model
        discrepancy = self._options.discrepancy
        self._enough = 0.0 if discrepancy is None else discrepancy * self._noise
        self._strength = self._options.lambda_()
        self._signs = np.random.default_rng(0)
        self._norm = _norm(self._data) or 1.0
        self.residuals.append(_norm(self._data) / self._norm)
        self._is_warm = False
        self._before: tuple[RealArray, RealArray] | None = None  # the last step and the A-lines that it explains

    def run(self, start: RealArray | None = None) -> RealArray:
        """Run the iteration until a stopping rule applies and return the image.

        It begins with the image ``start``, scaled to the data, if that explains most of them; else with zero.
        """
        image: RealArray = np.zeros(self._model.volume_shape, self._data.dtype, like=self._data)
        residual = self._data.copy()
        if start is not None:
            begun, explained = self._scaled(start)
            left = _norm(self._data - explained) / self._norm
            self._is_warm = self._beyond(left) <= WARM_MISFIT * self._beyond(1.0)
            if self._is_warm:
                image = begun
                residual -= explained
                self.residuals.append(left)
        while self.done < self._options.iterations:
            self._look()
            step = self._step(image, residual)
            self.done += 1
            explained = self._forward(step)
            if not self._is_combined(step, explained, residual):
                if self._is_lowered(self.residuals[-1]):
                    continue
                self.stopped = "misfit"
                break
            self._take(image, step, residual, explained)
            self._before = step, explained
            before, last = self.residuals[-2:]
            if last * self._norm <= self._enough:
                self.stopped = "discrepancy"
                break
            if _norm(step) <= self._options.change * _norm(image):
                self.stopped = "change"
                break
            if (self.done > 1 or self._is_warm) and self._is_small_gain(before, last) and not self._is_lowered(last):
                self.stopped = "misfit"
                break
        self._before = None
        return self._refitted(image, residual)

    def _step(self, image: RealArray, residual: RealArray) -> RealArray:
        """Return the step of one iteration: thresholded sum of image and back-projected residual, less the image."""
        signs = like(self._signs.choice(np.array([-1, 1], residual.dtype), len(residual)), residual)
        streaks = rms_per_depth(self._back(residual * signs[:, None]))
        step = self._back(residual)
        cut = np.full_like(streaks, np.finfo(step.dtype).max)
        cut[self._support] = (self._strength * np.minimum(noise_level(step), streaks))[self._support]
        step += image
        shrink(step, like(cut.astype(step.dtype), step), non_negative=self._options.non_negative)
        step -= image
        return step

    def _is_combined(self, step: RealArray, explained: RealArray, residual: RealArray) -> bool:
        """Combine a step with the one before to where the misfit is least, in place; False if too short to matter."""
        length, momentum = _optimal_step(residual, explained), 0.0
        if self._before is not None:
            both, momentum = optimal_pair(residual, explained, self._before[1], length)
            length, momentum = length + DAMPING * (both - length), DAMPING * momentum
        length = min(length, _LONGEST)
        if length < MIN_STEP:
            return False
        for values, last in zip((step, explained), self._before or (None, None), strict=True):
            values *= values.dtype.type(length)
            if momentum and last is not None:
                last *= last.dtype.type(momentum)
                values += last
        return True

    def _refitted(self, image: RealArray, residual: RealArray) -> RealArray:
        """Refit the image's non-zero voxels without fitting the noise, and scale it to the data's energy."""
        is_clipped = self._options.non_negative and image.min() < 0  # steps longer than 1 go beyond
        if is_clipped:
            np.maximum(image, 0, out=image)
        if is_clipped or self._applied is not self._model:
            self._applied = self._model
            explained = self._forward(image)
            np.subtract(self._data, explained, out=residual)
            self.residuals[-1] = _norm(residual) / self._norm
        for _ in range(self._options.refits):
            if _norm(residual) <= 1.001 * self._enough:  # rounded, just there
                break
            self._look()
            step = self._back(residual)
            step *= image != 0
            explained = self._forward(step)
            length = self._no_further(_optimal_step(residual, explained), residual, explained)
            if length <= 0:
                break
            step *= step.dtype.type(length)
            explained *= explained.dtype.type(length)
            self._take(image, step, residual, explained)
        image *= image.dtype.type(self._scale(residual))
        if self._options.non_negative:
            np.maximum(image, 0, out=image)
        self._look()
        return image

    def _scale(self, residual: RealArray) -> float:
        """Return the factor that gives the image's A-lines the energy of the data without their noise.

        With data A h + n and A-lines e = A f that do not contain n, ⟨e, data⟩ is ⟨A f, A h⟩ and ‖data‖² less ‖n‖² is
        ‖A h‖²: their ratio is 1 for an image whose amplitudes, as far as sensors see them, are those of the object h.
        """
        energy = self._norm**2 - self._noise**2
        common = self._norm**2 - float(np.vdot(residual, self._data))
        return float(np.clip(energy / common, 1.0, MAX_SCALE)) if common > 0 else 1.0

    def _no_further(self, length: float, residual: RealArray, explained: RealArray) -> float:
        """Return the step length at which the residual equals the noise, if shorter than the optimal step."""
        size, left = _norm(explained), _norm(residual)
        if length <= 0:
            return 0.0
        return length - float(np.sqrt(max(0.0, length**2 - (left**2 - self._enough**2) / size**2)))

    def _take(self, image: RealArray, step: RealArray, residual: RealArray, explained: RealArray) -> None:
        """Move image and residual by a step, in place."""
        image += step
        residual -= explained
        self.residuals.append(_norm(residual) / self._norm)

    def _is_small_gain(self, before: float, after: float) -> bool:
        """Return whether a step took away little of the residual in excess of the noise."""
        left = self._beyond(after)
        least = MIN_GAIN if left > min(LITTLE_LEFT * self._beyond(1.0), self._noise) else MIN_LAST_GAIN
        return left > (1 - least) * self._beyond(before)

    def _is_lowered(self, misfit: float) -> bool:
        """Lower the threshold if much of the data is unexplained; return whether it was."""
        is_high = self._options.strength is None and self._strength > MIN_STRENGTH
        if not is_high or self._beyond(misfit) <= MAX_UNEXPLAINED * self._beyond(1.0):
            return False
        self._strength = max(MIN_STRENGTH, self._strength * LOWERED)
        return True

    def _beyond(self, misfit: float) -> float:
        """Return the norm of the residual in excess of the noise."""
        return float(np.sqrt(max(0.0, (misfit * self._norm) ** 2 - self._noise**2)))

    def _back(self, traces: RealArray) -> RealArray:
        self.products += 1
        volume = self._direct.run(traces, cancelled=self._cancelled)
        assert isinstance(volume, Volume)  # noqa: S101 - of one set of traces
        return volume.values


def noise_level(values: RealArray) -> NDArray[np.float64]:
    """Estimate the standard deviation of streaks at each depth, shape (Nz,), from the median of absolute values."""
    lateral = tuple(range(values.ndim - 1))
    every = max(1, int((np.prod(values.shape[:-1]) / _ENOUGH_VALUES) ** (1 / len(lateral))))
    thinned = values[(slice(None, None, every),) * len(lateral)]
    return _smooth(_NORMAL * to_numpy(np.median(np.abs(thinned), axis=lateral)))


def rms_per_depth(values: RealArray) -> NDArray[np.float64]:
    """Return the root mean square of the image at each depth, shape (Nz,)."""
    squares = sum(
        to_numpy(np.einsum("...z,...z->...z", part, part).reshape(-1, part.shape[-1]).sum(axis=0))
        for part in iter_rows(values)
    )
    return _smooth(np.sqrt(squares / np.prod(values.shape[:-1])))


def shrink(values: RealArray, cut: RealArray, *, non_negative: bool) -> None:
    """Apply the thresholding rule v·(1 − (c/|v|)^1.5) in place, 0 below c; row by row to save memory.

    ``cut`` (Nz,) is c at each depth. Negative values become 0 if ``non_negative``.
    """
    least = np.maximum(cut, np.finfo(values.dtype).tiny)
    for part in iter_rows(values):
        if non_negative:
            np.maximum(part, 0, out=part)
        ratio = np.maximum(np.abs(part), least)
        np.divide(cut, ratio, out=ratio)
        ratio *= np.sqrt(ratio)
        np.subtract(1, ratio, out=ratio)
        part *= ratio


def _smooth(levels: RealArray) -> NDArray[np.float64]:
    return np.convolve(np.pad(levels, len(_SMOOTH) // 2, mode="edge"), _SMOOTH, "valid")


def _optimal_step(residual: RealArray, explained: RealArray) -> float:
    """Return the step length that minimises the residual; 0 if the step explains nothing."""
    size = float(np.vdot(explained, explained))
    return float(np.vdot(residual, explained)) / size if size > 0 else 0.0


def optimal_pair(residual: RealArray, first: RealArray, second: RealArray, alone: float) -> tuple[float, float]:
    """Return the factors of two directions' A-lines that minimise the residual; ``alone`` and 0 if not both of use.

    Of use is a factor from the least step to the longest for the first, and above 0, up to 1, for the second.
    """
    a, b, c = (float(np.vdot(u, v)) for u, v in ((first, first), (first, second), (second, second)))
    determinant = a * c - b * b
    if determinant <= 1e-6 * a * c:
        return alone, 0.0
    p, q = float(np.vdot(residual, first)), float(np.vdot(residual, second))
    length, momentum = (p * c - q * b) / determinant, (q * a - p * b) / determinant
    return (length, momentum) if MIN_STEP <= length <= _LONGEST and 0 < momentum <= 1 else (alone, 0.0)


def _norm(values: RealArray) -> float:
    return float(np.linalg.norm(values))
