"""Minimum of a sum of squared residuals over several parameters: Newton step, and sandwich covariance.

The second derivatives of each parameter are differences of the misfit. Those of pairs of parameters are of
Gauss–Newton form, scaled to them, so that the matrix is positive wherever each parameter has a minimum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
FARTHEST = 2.0
"""Most change of a parameter in a step along a principal axis, in units of the differences."""


@dataclass(frozen=True)
class Minimum:
    """Newton step to the minimum of a misfit, in units of the finite differences.

    Parameters
    ----------
    step
        (P,) to the minimum.
    covariance
        (P, P) of its place: sandwich estimator over the sensors, and the range in undetermined directions.
    undetermined
        (P, K) directions along which the misfit has no minimum within the range.
    """

    step: Floats
    covariance: Floats
    undetermined: Floats

    def within(self, change: Floats) -> Floats:
        """Return a change without its part along undetermined directions, unless there is one parameter."""
        if len(change) == 1 or not self.undetermined.size:
            return change
        return change - self.undetermined @ np.linalg.lstsq(self.undetermined, change, rcond=None)[0]


def least(
    middle: NDArray[Any], behind: Sequence[NDArray[Any]], ahead: Sequence[NDArray[Any]], reach: Floats
) -> Minimum:
    """Return the minimum of a sum of squares.

    Parameters
    ----------
    middle, behind, ahead
        Residuals (M, N) of each sensor: where the parameters are, and for each of P parameters one unit less and more.
    reach
        (P,) half-widths of the ranges searched, in units.
    """
    slopes, curvatures = _derivatives(middle, behind, ahead)
    count = len(reach)
    values, axes = np.linalg.eigh(curvatures.sum(axis=2) * np.outer(reach, reach))
    directions = reach[:, None] * axes  # along the principal axes, one range long
    slope = (directions.T @ slopes).sum(axis=1)
    longest = FARTHEST / np.abs(directions).max(axis=0)
    determined = values > 0
    safe = np.where(determined, values, 1.0)
    along = np.where(determined, np.clip(-slope / safe, -longest, longest), -np.sign(slope) * longest)
    scores = slopes + np.einsum("ijm,j->im", curvatures, directions @ along)
    scores = directions.T @ (scores - scores.mean(axis=1, keepdims=True)) / safe[:, None]
    if count > 1:  # of one parameter, the range that is allowed decides
        determined &= np.linalg.norm(scores, axis=1) < 1
        along = np.where(determined, along, 0.0)
    scores[~determined] = 0.0
    inner = scores @ scores.T
    inner[~determined, ~determined] = longest[~determined] ** 2 if count == 1 else 1.0
    return Minimum(directions @ along, directions @ inner @ directions.T, directions[:, ~determined])


def _derivatives(
    middle: NDArray[Any], behind: Sequence[NDArray[Any]], ahead: Sequence[NDArray[Any]]
) -> tuple[Floats, Floats]:
    """Return the first (P, M) and second (P, P, M) derivatives of each sensor's misfit."""
    base, count = _squares(middle), len(ahead)
    low, high = ([_squares(each) for each in side] for side in (behind, ahead))
    slopes = np.array([(b - a) / 2 for a, b in zip(low, high, strict=True)])
    curvatures = np.empty((count, count, len(base)))
    changes = [(np.asarray(b, np.float64) - a) / 2 for a, b in zip(behind, ahead, strict=True)]
    scale = []
    for i, change in enumerate(changes):
        curvatures[i, i] = high[i] - 2 * base + low[i]
        own = 2 * float(_squares(change).sum())
        scale.append(np.sqrt(max(0.0, float(curvatures[i, i].sum())) / own) if own > 0 else 0.0)
        for j in range(i):
            product = 2 * np.einsum("mn,mn->m", change, changes[j])
            curvatures[i, j] = curvatures[j, i] = scale[i] * scale[j] * product
    return slopes, curvatures


def _squares(residuals: NDArray[Any]) -> Floats:
    return np.asarray(np.sum(np.square(residuals, dtype=np.float64), axis=1))
