"""A volume as an npy file, piece by piece, so that no request holds a whole volume."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np

from steradian.errors import DamagedFile

PIECE_BYTES = 4 * 2**20


def stream_npy(path: Path) -> tuple[int, Iterator[bytes]]:
    """Open a volume file and return the length of its npy form and the pieces of it.

    Raises
    ------
    DamagedFile
        When the file cannot be read.
    """
    try:
        with h5py.File(path, "r") as file:
            values = file["values"]
            shape, kind, size = values.shape, values.dtype, values.nbytes
    except (OSError, KeyError) as error:
        raise DamagedFile(f"the volume cannot be read: {error}") from error
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": np.lib.format.dtype_to_descr(kind), "fortran_order": False, "shape": shape}
    )
    rows = max(1, PIECE_BYTES * shape[0] // max(1, size))
    return len(header.getvalue()) + size, _pieces(path, header.getvalue(), shape[0], rows)


def _pieces(path: Path, header: bytes, count: int, rows: int) -> Iterator[bytes]:
    yield header
    with h5py.File(path, "r") as file:
        for start in range(0, count, rows):
            yield np.ascontiguousarray(file["values"][start : start + rows]).tobytes()
