"""Assignment of a recording's rows to the voxels of a binary mask: MATLAB (column-major) or Python order.

MATLAB's k-Wave counts voxels with the first axis fastest, k-wave-python since 0.6 with the last one. A file does not
say which; the A-lines of neighbouring voxels do, for they are alike.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.scans.importing.aline_blocks import TraceBlocks
from steradian.scans.importing.axis_inference import likeness
from steradian.scans.importing.import_remarks import remark

Order = Literal["matlab", "python"]
WORDS = {"matlab": "MATLAB's (first axis fastest)", "python": "Python's (last axis fastest)"}
PAIRS = 400
MARGIN = 0.1
"""The neighbours' mean correlation is so much larger in the order that is taken."""
BY_PYTHON = re.compile(rb"Platform: (posix|nt|java|CPython)")


def written_by_python(path: Path) -> bool:
    """Return whether a MATLAB file was written by SciPy or hdf5storage, according to its header text."""
    with path.open("rb") as file:
        return BY_PYTHON.search(file.read(116)) is not None


def ordered(points: NDArray[np.float64], order: Order) -> NDArray[np.float64]:
    """Return grid points (M, A) sorted in MATLAB's (column-major) or Python's (row-major) order."""
    keys = points if order == "matlab" else points[:, ::-1]
    return points[np.lexsort(keys.round(12).T)]


def settle_order(
    table: TraceBlocks, points: NDArray[np.float64], said: Order | None, usual: Order, delay: int, *, python: bool
) -> NDArray[np.float64]:
    """Return the mask's points (M, A) in the order of the A-lines, decided by description, samples or convention.

    Parameters
    ----------
    table
        The A-lines.
    points
        Of the mask, in any order.
    said
        Order stated in the description, if any.
    usual
        Order used if the samples do not decide and MATLAB or Octave wrote the file.
    delay
        The longest delay between neighbours in samples.
    python
        Whether another program wrote it.

    Raises
    ------
    InvalidInput
        When the samples do not tell, and no convention does.
    """
    choices: dict[Order, NDArray[np.float64]] = {
        "matlab": ordered(points, "matlab"),
        "python": ordered(points, "python"),
    }
    if said is not None:
        return choices[said]
    if np.array_equal(choices["matlab"], choices["python"]) or table.points != len(points):
        return choices[usual]
    alike = {name: _alike(table, where, delay) for name, where in choices.items()}
    best = max(alike, key=lambda name: alike[name])
    worst: Order = "python" if best == "matlab" else "matlab"
    if alike[best] - alike[worst] >= MARGIN:
        if best != "matlab":
            figures = f"{alike[best]:.2f} against {alike[worst]:.2f}"
            remark(f"the mask's rows were taken in {WORDS[best]} order: neighbours correlate by {figures}")
        return choices[best]
    if python:
        raise InvalidInput(
            "mask_order",
            f"missing, and neighbouring A-lines correlate by {alike['matlab']:.2f} in MATLAB's order of the mask, "
            f"by {alike['python']:.2f} in Python's",
            '"matlab" (first axis fastest) or "python" (last axis fastest, k-wave-python since 0.6), in a description',
        )
    remark(f"the mask's rows were taken in {WORDS[usual]} order, as the program that wrote the file counts")
    return choices[usual]


def _alike(table: TraceBlocks, points: NDArray[np.float64], delay: int) -> float:
    """Return the mean correlation of A-lines of neighbouring points, if row m belongs to point m."""
    from scipy.spatial import KDTree

    picked = np.unique(np.linspace(0, len(points) - 1, min(PAIRS, len(points))).round().astype(int))
    nearest = np.asarray(KDTree(points).query(points[picked], k=2)[1])[:, 1]
    rows = {row: place for place, row in enumerate(np.unique(np.concatenate([picked, nearest])).tolist())}
    lines = np.empty((len(rows), table.samples), np.float32)
    for start, block in table.blocks():
        if start >= table.points:
            break
        for row in range(start, start + len(block)):
            if row in rows:
                lines[rows[row]] = block[row - start]
    first, second = ([rows[row] for row in each.tolist()] for each in (picked, nearest))
    with np.errstate(all="ignore"):
        found = likeness(lines[first], lines[second], delay)
    return float(np.nanmean(found)) if np.isfinite(found).any() else 0.0
