"""Lookup of the most recently stored row of a scan file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from google_crc32c import value as crc32c
from numpy.typing import NDArray

from steradian.scans.file import schema

if TYPE_CHECKING:
    import h5py


def latest_row(file: h5py.File) -> int | None:
    """Return the most recently stored row, also while the scan runs; ``None`` if no row is stored.

    A-lines are stored in the order in which their rows were given to the scanner: it is the last one up to which all of
    them are there. Where none of them is there yet, it is the row of the latest shot; shots are counted anew when
    the scanner boots.

    Raises
    ------
    KeyError
        Where the file lacks a dataset.
    """
    stored = file["alines/status"][:] == schema.STORED
    if not stored.any():
        return None
    given = _uploaded_rows(file)
    missing = np.flatnonzero(~stored[given])
    done = int(missing[0]) if len(missing) else len(given)
    if done:
        return int(given[done - 1])
    return int(np.where(stored, np.asarray(file["alines/shot"], np.int64), -1).argmax())


def _uploaded_rows(file: h5py.File) -> NDArray[np.int64]:
    """Return the rows of the last upload to the scanner, in order; empty if the record's checksum is wrong."""
    head, queue = np.asarray(file["run/upload"]), np.asarray(file["run/queue"])
    rows = queue[: max(0, int(head[0]))]
    proven = crc32c(rows.tobytes() + head[:-1].tobytes()) == int(head[-1])
    return rows.astype(np.int64) if proven else np.zeros(0, np.int64)
