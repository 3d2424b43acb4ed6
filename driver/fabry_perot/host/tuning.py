"""Tuning of the film's bias wavelength: sweeps at points, and tuning maps.

A Fabry–Pérot film is read out on the slope of its interference fringe. A sweep of the interrogation wavelength gives
the reflected DC level; the *bias wavelength* is where that curve rises most steeply (above the resonance; on the other
flank the signal has the other sign), the *sensitivity* its slope there, the *reflectivity* its level off resonance.
Films drift, so a map is kept and compared with a later one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabry_perot.errors import PlanInvalid

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class TuningCurve:
    """Wavelength sweep at one point: DC level as a function of the interrogation wavelength.

    Parameters
    ----------
    wavelengths
        (S,) equally spaced, in m.
    levels
        (S,) DC levels in V.
    """

    wavelengths: Array
    levels: Array

    @property
    def slope(self) -> Array:
        """Derivative (S,) of the level with respect to wavelength, in V/m."""
        slope: Array = np.gradient(self.levels, self.wavelengths)
        return slope

    @property
    def bias(self) -> float:
        """Wavelength of the steepest rise in m, refined between samples by a parabola."""
        steep = self.slope
        at = int(np.clip(np.argmax(steep), 1, len(steep) - 2))
        before, here, after = steep[at - 1 : at + 2]
        bend = before - 2 * here + after
        offset = 0.5 * (before - after) / bend if bend < 0 else 0.0
        return float(self.wavelengths[at] + np.clip(offset, -1, 1) * (self.wavelengths[1] - self.wavelengths[0]))

    @property
    def sensitivity(self) -> float:
        """Slope at the steepest rise, in V/m."""
        return float(self.slope.max())

    @property
    def reflectivity(self) -> float:
        """Level in V off resonance."""
        return float(np.quantile(self.levels, 0.9))


@dataclass(frozen=True, slots=True, eq=False)
class TuningMap:
    """Tuning map: bias wavelength, sensitivity and reflectivity at points of the film.

    Parameters
    ----------
    points
        (M, 2) in m.
    wavelength
        (M,) bias wavelengths in m; hand it to ``Scanner.upload(wavelength=…)``.
    sensitivity
        (M,) in V/m.
    reflectivity
        (M,) in V.
    """

    points: Array
    wavelength: Array
    sensitivity: Array
    reflectivity: Array

    @classmethod
    def from_curves(cls, points: Array, curves: Sequence[TuningCurve]) -> TuningMap:
        """Create the map from one sweep per point."""
        columns = [[curve.bias, curve.sensitivity, curve.reflectivity] for curve in curves]
        bias, sensitivity, reflectivity = np.asarray(columns, dtype=np.float64).T.copy()
        return cls(points, bias, sensitivity, reflectivity)

    def save(self, path: Path) -> None:
        """Write the map as a NumPy archive (npz)."""
        fields = {name: getattr(self, name) for name in ("points", "wavelength", "sensitivity", "reflectivity")}
        with path.open("wb") as file:
            np.savez(file, **fields)

    @classmethod
    def load(cls, path: Path) -> TuningMap:
        """Read a map written by :meth:`save`."""
        with np.load(path, allow_pickle=False) as file:
            return cls(file["points"], file["wavelength"], file["sensitivity"], file["reflectivity"])

    def compare(self, other: TuningMap, *, linewidth: float = 0.5e-9) -> TuningDrift:
        """Return the change of the film from this map to ``other``, a map of the same points.

        A point whose bias moved by more than a quarter of ``linewidth`` (m), or that lost half its sensitivity, should
        be tuned anew.
        """
        if self.points.shape != other.points.shape or not np.allclose(self.points, other.points, atol=1e-9, rtol=0):
            raise PlanInvalid("other", f"{len(other.points)} points", "a map of the same points")
        shift = other.wavelength - self.wavelength
        ratio = other.sensitivity / self.sensitivity
        stale = np.flatnonzero((np.abs(shift) > linewidth / 4) | (ratio < 0.5))
        return TuningDrift(shift, ratio, other.reflectivity / self.reflectivity, stale)


@dataclass(frozen=True, slots=True, eq=False)
class TuningDrift:
    """Change between two tuning maps of the same points.

    Parameters
    ----------
    shift
        (M,) change of the bias wavelength in m.
    sensitivity, reflectivity
        (M,) ratios, later over earlier.
    stale
        Indices of the points to tune anew.
    """

    shift: Array
    sensitivity: Array
    reflectivity: Array
    stale: NDArray[np.intp]
