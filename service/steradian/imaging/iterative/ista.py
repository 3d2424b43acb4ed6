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

Waves that no sensor hears, because they leave sideways, come back by thresholds and non-negativity alone, little by
little, and say nothing in the misfit: amplitudes end 4 to 12 % too low, even without noise. Where the first image
leaves little of the data, so that streaks are weak, steps therefore begin ahead of the image (Nesterov 1983):

    y = f + β·p,   d = T(y + B(g − A y)) − y,   f ← y + a·d,   p the change of f before,

with a of least misfit. A step that would raise the misfit begins at f instead. The iteration takes four
steps at least: the first ones reach the level of the noise with voxels beside the object. With strong streaks, which
are stronger in y, there is no momentum.

The steps can use a model with less lateral padding, in which the last part of some A-lines contains sound of the
volume's periodic copies. The misfit is then computed once more with the model itself. At the end the voxels that were
found are fitted once more without thresholds, until only noise is left of the misfit, and the image is scaled such that
its A-lines have the energy of the data without their noise, which adds no noise to it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from steradian.imaging.engines.array_namespace import like
from steradian.imaging.iterative.base import IterativeSolver, StopReason
from steradian.imaging.iterative.step_lengths import MAX_STEP, MIN_STEP, optimal_pair, optimal_step
from steradian.imaging.iterative.thresholds import noise_level, rms_per_depth, shrink
from steradian.imaging.operators import ForwardOperator
from steradian.imaging.plan import ReconstructionPlan
from steradian.imaging.volume import RealArray, Volume

MOMENTUM = 0.65  # β where the first image leaves little of the data beyond the noise:
LITTLE_FIRST, MUCH_FIRST = 0.265, 0.317  # shares; from the second on there is no momentum,
RAMP = 4.5  # and in between, β is less by so much for each unit above the first
MIN_STEPS = 4  # with momentum
MAX_RISE = 1.0  # of the misfit by a step with momentum: none
DAMPING = 0.5  # share of the way from the least misfit of a step to that of the step and the one before
MIN_GAIN = 0.05  # share of the misfit beyond the noise that a step has to take away for another one to follow
MIN_LAST_GAIN = 0.15  # the same where little is left:
LITTLE_LEFT = 0.15  # less than this share of the data beyond the noise, and less than the noise
MAX_UNEXPLAINED = 0.25  # share of the data beyond the noise with which the iteration does not end before
MIN_STRENGTH, LOWERED = 2.0, 2 / 3  # the threshold was lowered, each time to that share, to that many deviations
MAX_SCALE = 1.1  # of the amplitudes at the end: more is missing where the model is wrong
WARM_MISFIT = 0.45  # beyond the noise, above which a start image is of another object and not used


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
        self._momentum = 0.0
        self._before: tuple[RealArray, RealArray] | None = None  # the last change and the A-lines that it explains

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
            if not self._is_advanced(image, residual):
                if self._is_lowered(self.residuals[-1]):
                    continue
                self.stopped = "misfit"
                break
            before, last = self.residuals[-2:]
            if self.done == 1 and not self._is_warm:
                left = self._beyond(last) / (self._beyond(1.0) or 1.0)
                self._momentum = MOMENTUM - RAMP * max(0.0, left - LITTLE_FIRST) if left < MUCH_FIRST else 0.0
            reason = self._ending(image, before, last)
            if reason is not None:
                self.stopped = reason
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

    def _is_advanced(self, image: RealArray, residual: RealArray) -> bool:
        """Take a step, in place; False, and nothing is taken, if it is too short to matter."""
        ahead, size, before = None, _norm(residual), self._before
        if before is not None and self._momentum:
            ahead, self._before = before, None
            for values in ahead:
                values *= values.dtype.type(self._momentum)
            image += ahead[0]
            residual -= ahead[1]
        step = self._step(image, residual)
        self.done += 1
        explained = self._forward(step)
        if ahead is not None:
            length = min(optimal_step(residual, explained), MAX_STEP)
            if length < MIN_STEP or _norm(residual - residual.dtype.type(length) * explained) > MAX_RISE * size:
                image -= ahead[0]
                residual += ahead[1]
                step += ahead[0]
                explained += ahead[1]
                ahead = None
        if not self._is_scaled(step, explained, residual):
            return False
        self._take(image, step, residual, explained)
        if ahead is not None:
            step += ahead[0]
            explained += ahead[1]
        self._before = step, explained
        return True

    def _is_scaled(self, step: RealArray, explained: RealArray, residual: RealArray) -> bool:
        """Scale a step to where the misfit is least, without momentum also along the change before; False if short."""
        length, momentum = optimal_step(residual, explained), 0.0
        if self._before is not None:
            both, momentum = optimal_pair(residual, explained, self._before[1], length)
            length, momentum = length + DAMPING * (both - length), DAMPING * momentum
        length = min(length, MAX_STEP)
        if length < MIN_STEP:
            return False
        for values, last in zip((step, explained), self._before or (None, None), strict=True):
            values *= values.dtype.type(length)
            if momentum and last is not None:
                last *= last.dtype.type(momentum)
                values += last
        return True

    def _ending(self, image: RealArray, before: float, last: float) -> StopReason | None:
        """Return the stopping rule that applies to the misfits before and after a step; None: another step follows."""
        assert self._before is not None  # noqa: S101 - after a step
        is_early = bool(self._momentum) and self.done < MIN_STEPS
        if last * self._norm <= self._enough and not is_early:
            return "discrepancy"
        if _norm(self._before[0]) <= self._options.change * _norm(image):
            return "change"
        is_early = is_early or (self.done == 1 and not self._is_warm)
        return "misfit" if not is_early and self._is_small_gain(before, last) and not self._is_lowered(last) else None

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
            length = self._no_further(optimal_step(residual, explained), residual, explained)
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


def _norm(values: RealArray) -> float:
    return float(np.linalg.norm(values))
