"""Reader of tuning maps as text matrices of LabVIEW-controlled scanners (``… array_data_wavelength.txt``).

The layout is assumed, for no description of it is public: a row of numbers for each line of the scan along y, a column
for each point along x, wavelengths in nm, the middle of the matrix at the origin (point j of n at (j − n//2)·pitch).
The pitch is not in the file and has to be given. Points that were not tuned are 0 or nan, and are left out.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import DamagedFile, InvalidInput

Array = NDArray[np.float64]
MOST_BYTES = 64 << 20
WAVELENGTHS = (300.0, 3000.0)
"""Bias wavelengths in nm; no reflectivity, voltage or phase of a map lies there by chance."""


def read_text_map(path: Path, pitch: float | None) -> tuple[Array, Array]:
    """Read a text matrix of bias wavelengths.

    Parameters
    ----------
    path
        The text.
    pitch
        Distance of columns and of rows in m.

    Returns
    -------
    positions, wavelengths
        (N, 2) and (N,), in m.

    Raises
    ------
    DamagedFile
        When it is no matrix of numbers.
    InvalidInput
        When the pitch is not given, or the numbers are no wavelengths.
    """
    matrix = _matrix(path)
    if pitch is None:
        allowed = "the distance of the matrix's columns and rows, which the text does not state"
        raise InvalidInput("tuning_pitch", "missing", allowed)
    tuned = np.isfinite(matrix) & (matrix != 0)
    values = matrix[tuned]
    if not len(values) or values.min() < WAVELENGTHS[0] or values.max() > WAVELENGTHS[1]:
        span = f"{values.min():g} to {values.max():g}" if len(values) else "no tuned point"
        raise InvalidInput(
            "tuning",
            f"{path.name} with {span}",
            f"wavelengths, {WAVELENGTHS[0]:g} to {WAVELENGTHS[1]:g} (nm); maps of reflectivity or sensitivity tell "
            "none, and are often beside one that ends in _wavelength.txt",
        )
    rows, columns = np.nonzero(tuned)
    middle = np.array(matrix.shape) // 2
    return pitch * np.column_stack([columns - middle[1], rows - middle[0]]), values / 1e9


def is_text_matrix(path: Path) -> bool:
    """Return whether a text is a matrix, not a table with named columns: its first line contains numbers."""
    with path.open("rb") as file:
        start = file.read(4096).removeprefix(b"\xef\xbb\xbf")
    lines = [line for line in start.splitlines() if line.strip() and not line.lstrip().startswith((b"#", b"%"))]
    return bool(lines) and _row(lines[0].decode("latin-1")) is not None


def _matrix(path: Path) -> Array:
    if path.stat().st_size > MOST_BYTES:
        raise DamagedFile(f"{path} has {path.stat().st_size} bytes; allowed: {MOST_BYTES}")
    rows: list[list[float]] = []
    for number, line in enumerate(path.read_text("latin-1").removeprefix("ï»¿").splitlines(), 1):
        if not line.strip() or line.lstrip().startswith(("#", "%")):
            continue
        row = _row(line)
        if row is None:
            raise DamagedFile(f"{path.name}, line {number} is not a row of numbers")
        if rows and len(row) != len(rows[0]):
            raise DamagedFile(f"{path.name}, line {number} has {len(row)} numbers, the first has {len(rows[0])}")
        rows.append(row)
    return np.array(rows, np.float64).reshape(len(rows), -1)


def _row(line: str) -> list[float] | None:
    """Parse the numbers of a line, separated by tabs, semicolons, commas or spaces; decimal commas if unambiguous."""
    separator = next((each for each in ("\t", ";") if each in line.strip()), None)
    if separator is not None:
        fields = [field.strip().replace(",", ".") for field in line.strip().split(separator)]
    else:
        fields = re.split(r"\s*,\s*|\s+", line.strip().rstrip(","))
    try:
        return [float(field) for field in fields]
    except ValueError:
        return None
