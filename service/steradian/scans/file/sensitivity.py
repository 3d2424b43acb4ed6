"""Film sensitivity of A-lines at the bias wavelength used, relative to the optimum."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from steradian.plans import Fringe
from steradian.scans.file.aline_metadata import ShotTable

if TYPE_CHECKING:
    import h5py

MIN_SENSITIVITY = 0.1
"""A plan gives up no more than nine tenths; what is far beside its best wavelength is noise, and is not blown up."""


def sensitivity_of(file: h5py.File, table: ShotTable, points: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the film sensitivity (n,) of A-lines relative to the optimum bias, from the plan's fringe model.

    1 where the file names no best wavelength, or the scanner did not say which one it had set.

    Parameters
    ----------
    file
        The open scan file.
    table
        Its rows of these A-lines.
    points
        (n,) their points.
    """
    plan, used = file["plan"], table["wavelength_m"].astype(np.float64)
    if "wavelengths" not in plan or "document" not in plan.attrs:
        return np.ones(len(points))
    best = np.asarray(plan["wavelengths"], np.float64)[points]
    fringe = Fringe.create(**json.loads(plan.attrs["document"]).get("fringe", {}))
    left = np.maximum(1 - fringe.sensitivity_loss(used - best), MIN_SENSITIVITY)
    return np.where(used > 0, left, 1.0)
