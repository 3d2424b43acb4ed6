"""Readers and writers of mask files (JSON, CSV, npy)."""

from __future__ import annotations

import csv
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from steradian.core.atomic_files import atomic_write
from steradian.core.exceptions import DamagedFile, InvalidInput, NotFound
from steradian.core.validation_errors import to_invalid_input
from steradian.masks.explicit_points import area_of_weights, custom_mask
from steradian.masks.mask import Mask

UNITS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6}
Points = tuple[NDArray[np.float64], NDArray[np.float64] | None, float | None]
"""Positions in metres, weights, and the area in m² (m) that these sum to, if the file says."""


def read_mask(path: Path, aperture: float | None = None) -> Mask:
    """Read a mask file.

    Parameters
    ----------
    path
        ``.json`` as written by :func:`steradian.masks.write_mask`; ``.csv`` with a heading such as ``x_mm, y_mm``
        (units m, mm or um) and perhaps a column ``weight``, or without a heading in metres; ``.npy`` of shape (M, 2)
        or (M, 3): x, y and perhaps weight. (An npy of a line has shape (M, 1); its weights need JSON or CSV.) Weights
        in a column that names a unit (``weight_m2``, ``weight_mm2``; ``weight_m`` of a line), or in one without a name
        that could be m² (a sum of at most four apertures), are areas and stay as they are; others are scaled to what
        the points sense, see :func:`steradian.masks.custom_mask`.
    aperture
        Side X in metres; needed for CSV and npy, which do not hold it.

    Raises
    ------
    NotFound
        When there is no such file.
    DamagedFile
        When it cannot be read as what its ending says.
    InvalidInput
        When a value in it is out of range, or ``aperture`` is missing or differs from the file's.
    """
    if not path.is_file():
        raise NotFound("file", str(path))
    if path.suffix.lower() == ".json":
        mask = _read_json(path)
        if aperture is not None and abs(aperture / mask.aperture - 1) > 1e-9:
            raise InvalidInput("aperture", aperture, f"the file's own, {mask.aperture:g} (m)")
        return mask
    if aperture is None:
        raise InvalidInput("aperture", "missing", f"> 0, at most 1 (m); {path.name} does not hold it")
    positions, weights, area = _read_npy(path) if path.suffix.lower() == ".npy" else _read_csv(path)
    area = area_of_weights(area, aperture, positions.shape[1])
    return custom_mask(positions, aperture, weights, sensed_area=area)


def _read_json(path: Path) -> Mask:
    try:
        return Mask.model_validate_json(path.read_bytes())
    except ValidationError as error:
        if error.errors(include_url=False)[0]["type"] == "json_invalid":
            raise DamagedFile(f"{path} is not JSON: {error.errors()[0]['msg']}") from error
        raise to_invalid_input(Mask, error) from error


def _read_csv(path: Path) -> Points:
    """Read positions and weights from a CSV file."""
    try:
        rows = [row for row in csv.reader(path.read_text(encoding="utf-8-sig").splitlines()) if row]
    except UnicodeDecodeError as error:
        raise DamagedFile(f"{path} is not text: {error}") from error
    heading = [] if not rows or _is_number(rows[0][0]) else [name.strip().lower() for name in rows.pop(0)]
    try:
        table = np.array(rows, dtype=np.float64)
    except ValueError as error:
        raise DamagedFile(f"{path} is not a table of numbers: {error}") from error
    if table.ndim != 2 or (heading and len(heading) != table.shape[1]):
        raise DamagedFile(f"{path} has no rows of the same length as its heading")
    if not heading:
        return _columns(path, table)
    axes = [index for index, name in enumerate(heading) if name.partition("_")[0] in ("x", "y")]
    scale = [UNITS.get(heading[index].partition("_")[2] or "m") for index in axes]
    if not axes or None in scale:
        raise DamagedFile(f"{path} has the heading {', '.join(heading)}; expected x_m, y_m (or mm, um) and weight")
    positions = table[:, axes] * np.array(scale, np.float64)
    column = next((index for index, name in enumerate(heading) if name.startswith("weight")), None)
    if column is None:
        return positions, None, None
    unit = UNITS.get(heading[column].partition("_")[2].removesuffix("2"))
    weights = table[:, column]
    return positions, weights, None if unit is None else float(weights.sum()) * unit ** len(axes)


def _read_npy(path: Path) -> Points:
    try:
        return _columns(path, np.asarray(np.load(path, allow_pickle=False), dtype=np.float64))
    except (ValueError, EOFError, TypeError) as error:
        raise DamagedFile(f"{path} is not an array of numbers: {error}") from error


def _columns(path: Path, table: NDArray[np.float64]) -> Points:
    if table.ndim != 2 or table.shape[1] not in (1, 2, 3):
        raise DamagedFile(f"{path} has the shape {table.shape}; expected (M, 2): x, y, or (M, 3): x, y, weight")
    if table.shape[1] < 3:
        return table, None, None
    return table[:, :2], table[:, 2], float(table[:, 2].sum())


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def write_mask(mask: Mask, path: Path) -> None:
    """Write a mask into a ``.json``, ``.csv`` or ``.npy`` file, according to the suffix.

    A CSV has the columns ``x_m, y_m, weight_m2`` (``x_m, weight_m`` for a line), an npy the same as an array
    (M, 3) or (M, 2). The file appears under its name only when it is whole.

    Raises
    ------
    InvalidInput
        When the ending is another one.
    """
    match path.suffix.lower():
        case ".json":
            data = (mask.model_dump_json() + "\n").encode()
        case ".csv":
            data = _csv(mask)
        case ".npy":
            buffer = BytesIO()
            np.save(buffer, np.column_stack([mask.positions, mask.weights]))
            data = buffer.getvalue()
        case ending:
            raise InvalidInput(
                "file",
                f"{path.name} ({ending or 'no ending'})",
                ".json, .csv or .npy; or .png, .pdf or .svg for a picture",
            )
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as file:
        file.write_bytes(data)


def _csv(mask: Mask) -> bytes:
    heading = "x_m,weight_m" if mask.is_line else "x_m,y_m,weight_m2"
    rows = np.column_stack([mask.positions, mask.weights]).tolist()
    lines = [heading, *(",".join(map(repr, row)) for row in rows)]
    return ("\n".join(lines) + "\n").encode()
