"""Measured tuning map of a film: optimum bias wavelengths at some places, interpolated with uncertainty."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from steradian.core.exceptions import DamagedFile, InvalidInput, NotFound
from steradian.core.validation import FloatArray, Value, quantity_field
from steradian.masks import Mask
from steradian.plans.files import read_json
from steradian.plans.text_tuning_map import is_text_matrix, read_text_map

SAME_PLACE = 1e-6
"""Points this close in metres to a place that was measured have its wavelength; a focus is some ten times wider."""
NEIGHBOURS = 8
"""Between places, a plane through so many of the nearest is used."""
COLUMNS = ("x_mm", "y_mm", "wavelength_nm")

Array = NDArray[np.float64]


class TuningMap(Value):
    """Optimum bias wavelengths, measured by sweeps at positions of the film (``fabry-perot tune``)."""

    positions: FloatArray
    """(N, 2) places in m."""
    wavelengths: FloatArray
    """(N,) best wavelengths in m."""
    repeatability: float = quantity_field("m", "Standard deviation of one sweep's result", ge=0, le=1e-8, default=0.0)

    @model_validator(mode="after")
    def _check(self) -> Self:
        count = len(self.wavelengths)
        if self.positions.shape != (count, 2) or self.wavelengths.ndim != 1 or not count:
            shapes = f"{self.positions.shape} and {self.wavelengths.shape}"
            raise InvalidInput("positions, wavelengths", shapes, "(N, 2) and (N,), N at least 1")
        if not 1e-7 < self.wavelengths.min() <= self.wavelengths.max() < 1e-5:
            span = f"{self.wavelengths.min():g} to {self.wavelengths.max():g}"
            raise InvalidInput("wavelengths", span, "1e-7 to 1e-5 (m)")
        return self

    @classmethod
    def read(cls, path: Path, *, pitch: float | None = None) -> Self:
        """Read a tuning map from a file.

        Parameters
        ----------
        path
            ``.npz`` of ``fabry-perot tune``, ``.csv`` with the columns x_mm, y_mm, wavelength_nm, ``.json``, or a text
            matrix of wavelengths in nm (:mod:`steradian.plans.text_tuning_map`).
        pitch
            Distance of such a matrix's columns and rows in m.

        Raises
        ------
        NotFound, DamagedFile
            When there is none, or it is something else.
        InvalidInput
            When a value is out of range.
        """
        if not path.is_file():
            raise NotFound("file", str(path))
        if path.suffix == ".json":
            return read_json(cls, path)
        try:
            if path.suffix == ".npz":
                with np.load(path, allow_pickle=False) as file:
                    places, wavelengths = file["points"], file["wavelength"]
            elif is_text_matrix(path):
                places, wavelengths = read_text_map(path, pitch)
            else:
                table = np.genfromtxt(path, delimiter=",", names=True, ndmin=1, encoding="utf-8-sig")
                x, y, wavelength = (table[name] for name in COLUMNS)
                places, wavelengths = 1e-3 * np.column_stack([x, y]), 1e-9 * wavelength
        except InvalidInput:
            raise
        except (ValueError, KeyError, IndexError, OSError) as error:
            raise DamagedFile(f"{path} is not a tuning map (columns {', '.join(COLUMNS)}): {error}") from error
        return cls.create(positions=places, wavelengths=wavelengths)

    def at(self, positions: Array) -> tuple[Array, Array]:
        """Return the interpolated optimum wavelengths at ``positions``, and their uncertainty.

        A place that was measured has what was measured. Anywhere else it is a plane through the nearest places, and
        its uncertainty is how far the same rule, applied to each of these places without itself, is off (rms).

        Parameters
        ----------
        positions
            (M, 2) in m.

        Returns
        -------
        wavelengths, uncertainty
            (M,) each, in m; one standard deviation.
        """
        from scipy.spatial import KDTree

        tree = KDTree(self.positions)
        distance, nearest = tree.query(positions, k=1)
        found = self.wavelengths[nearest]
        uncertainty = np.full(len(positions), self.repeatability)
        between = np.flatnonzero(distance > SAME_PLACE)
        if len(between):
            count = min(NEIGHBOURS, len(self.wavelengths))
            around = tree.query(positions[between], k=count)[1].reshape(len(between), count)
            found[between] = self._plane(positions[between], around)
            uncertainty[between] = np.sqrt((self._residuals(tree, count)[around] ** 2).mean(axis=1))
        return found, np.maximum(uncertainty, self.repeatability)

    def as_plan_fields(self, mask: Mask) -> dict[str, Any]:
        """Return the :class:`~steradian.plans.ScanPlan` fields of a mask that the map determines.

        The uncertainty is the root mean square over the mask's points.
        """
        wavelengths, uncertainty = self.at(mask.film_positions)
        rms = float(np.sqrt((uncertainty**2).mean()))
        return {"wavelengths": wavelengths, "wavelength_uncertainty": rms}

    def _residuals(self, tree: object, count: int) -> Array:
        """Return each position's deviation from the prediction by the others (N,), in m."""
        if len(self.wavelengths) == 1:
            raise InvalidInput("tuning map", "one place", "one at every point, or several to interpolate between")
        others = tree.query(self.positions, k=min(count, len(self.wavelengths) - 1) + 1)[1]  # type: ignore[attr-defined]
        own = others == np.arange(len(others))[:, None]
        own[~own.any(axis=1), -1] = True  # places that coincide
        residuals: Array = self.wavelengths - self._plane(self.positions, others[~own].reshape(len(others), -1))
        return residuals

    def _plane(self, positions: Array, around: NDArray[np.intp]) -> Array:
        """Fit a plane to the map positions ``around`` (M, K) each position, and evaluate there."""
        offsets = self.positions[around] - positions[:, None]
        reach = np.abs(offsets).max(axis=(1, 2), keepdims=True) + SAME_PLACE
        design = np.concatenate([np.ones((*around.shape, 1)), offsets / reach], axis=2)
        values = self.wavelengths[around]
        mean = values.mean(axis=1, keepdims=True)
        solved = np.linalg.pinv(design, rcond=1e-3)[:, 0]  # the plane's value at the position itself
        read = mean[:, 0] + (solved * (values - mean)).sum(axis=1)
        margin = np.ptp(values, axis=1) / 2
        bounded: Array = np.clip(read, values.min(axis=1) - margin, values.max(axis=1) + margin)
        return bounded
