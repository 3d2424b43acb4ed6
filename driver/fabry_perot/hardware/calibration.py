"""Calibration of galvo voltages to film positions, and of time zero."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
CUBIC = 3


@dataclass(frozen=True, slots=True, eq=False)
class GalvoCalibration:
    """Bivariate polynomials between film positions and galvo voltages, fitted to marks at known positions.

    Degree 1 is affine: scale, rotation, shear, offset. Degree 3 takes up the pincushion of two mirrors and a lens.

    Parameters
    ----------
    degree
        Of both polynomials.
    scales
        Metres, and volts, by which positions and volts are divided.
    to_volts, to_metres
        (T, 2) coefficients.
    residual
        Root mean square of how far each mark is from where all the others put it, in m.
    """

    degree: int
    scales: tuple[float, float]
    to_volts: Array
    to_metres: Array
    residual: float

    @classmethod
    def fit(cls, metres: Array, volts: Array, degree: int = CUBIC) -> GalvoCalibration:
        """Fit a calibration to the positions and voltages of marks.

        Parameters
        ----------
        metres
            (N, 2) places of the target's marks on the film.
        volts
            (N, 2) at which the beam was seen to be on them.
        degree
            1 needs 3 marks that are not on a line, 3 needs 10; twice as many show a bad one in the residual.

        Raises
        ------
        ValueError
            For too few marks, or marks on a line.
        """
        metres, volts = np.asarray(metres, dtype=np.float64), np.asarray(volts, dtype=np.float64)
        terms = (degree + 1) * (degree + 2) // 2
        if metres.shape != volts.shape or metres.ndim != 2 or metres.shape[1] != 2 or len(metres) <= terms:
            raise ValueError(f"{metres.shape} places and {volts.shape} volts; degree {degree} needs {terms + 1} marks")
        scales = (float(np.abs(metres).max()), float(np.abs(volts).max()))
        there, back = _terms(metres / scales[0], degree), _terms(volts / scales[1], degree)
        if min(np.linalg.matrix_rank(there), np.linalg.matrix_rank(back)) < terms:
            raise ValueError("the marks lie on a line, or on a curve that leaves the polynomial open")
        to_volts: Array = np.asarray(np.linalg.lstsq(there, volts, rcond=None)[0], dtype=np.float64)
        to_metres: Array = np.asarray(np.linalg.lstsq(back, metres, rcond=None)[0], dtype=np.float64)
        hat = np.einsum("nt,tn->n", there, np.linalg.pinv(there))  # how much each mark makes of its own volts
        left_out = (volts - there @ to_volts) / np.maximum(1 - hat, 1e-9)[:, None] * (scales[0] / scales[1])
        return cls(degree, scales, to_volts, to_metres, float(np.sqrt((left_out**2).sum(axis=1).mean())))

    def volts(self, metres: Array) -> Array:
        """Return the voltages (N, 2) that move the beam to positions (N, 2) in m."""
        found: Array = _terms(np.asarray(metres) / self.scales[0], self.degree) @ self.to_volts
        return found

    def metres(self, volts: Array) -> Array:
        """Return the positions (N, 2) in m to which voltages (N, 2) move the beam."""
        found: Array = _terms(np.asarray(volts) / self.scales[1], self.degree) @ self.to_metres
        return found

    def save(self, path: Path) -> None:
        """Write the calibration as JSON."""
        arrays = {"to_volts": self.to_volts.tolist(), "to_metres": self.to_metres.tolist()}
        document = {"degree": self.degree, "scales": self.scales, **arrays, "residual_m": self.residual}
        path.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: Path) -> GalvoCalibration:
        """Read a calibration written by :meth:`save`."""
        said = json.loads(path.read_text(encoding="utf-8"))
        metre, volt = said["scales"]
        to_volts, to_metres = np.array(said["to_volts"]), np.array(said["to_metres"])
        return cls(int(said["degree"]), (metre, volt), to_volts, to_metres, float(said["residual_m"]))


def _terms(points: Array, degree: int) -> Array:
    """Return the polynomial terms xᵖ·yᵠ (N, T) with p + q up to ``degree``."""
    x, y = np.asarray(points, dtype=np.float64).T
    return np.stack([x**p * y**q for p in range(degree + 1) for q in range(degree + 1 - p)], axis=1)


def time_zero(record: NDArray[np.generic], interval: float, earlier: float = 0.0) -> float:
    """Return the time (s) of a record's first sample after the laser pulse, measured with light absorbed by the film.

    Light on the film itself, or on a drop of ink on it, makes sound at the moment of the pulse and at no distance: the
    record begins to rise then. With it ``TriggerRecord.time_zero`` is set.

    Parameters
    ----------
    record
        (N_t,) mean over many shots, of which the first eighth lies before the pulse.
    interval
        Between samples, in s.
    earlier
        Time in s by which this record was begun earlier than usual, so that the pulse lies in it.

    Raises
    ------
    ValueError
        When nothing rises out of the noise.
    """
    values = np.asarray(record, dtype=np.float64)
    before = values[: max(8, len(values) // 8)]
    rest, noise = before.mean(), before.std()
    size = np.abs(values - rest)
    top = int(np.argmax(size))
    if not size[top] > 10 * max(noise, 1e-300):
        raise ValueError("no pulse in this record: no sample is ten times the noise away from rest")
    half = size[top] / 2
    low = int(np.flatnonzero(size[: top + 1] < half)[-1]) if (size[: top + 1] < half).any() else 0
    fraction = (half - size[low]) / (size[low + 1] - size[low])
    return earlier - (low + float(fraction)) * interval
