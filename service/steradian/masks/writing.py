"""Write masks as JSON, CSV or npy."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from steradian.core.atomic_files import atomic_write
from steradian.core.exceptions import InvalidInput

if TYPE_CHECKING:
    from steradian.masks.mask import Mask


def write_mask(mask: Mask, path: Path) -> None:
    """Write a mask as its name's ending says: ``.json``, ``.csv`` or ``.npy``.

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
            buffer = io.BytesIO()
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
