"""A-line counts of a scan that is no longer running."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from steradian.core.exceptions import DamagedFile, NotFound
from steradian.scans.file import schema
from steradian.scans.file.h5py_errors import HDF5_ERRORS
from steradian.scans.file.locking import open_for_reading
from steradian.storage.blobs.interface import BlobStore, scan_name


def scan_summary(arrays: BlobStore, own: Path, scan_id: str) -> dict[str, Any]:
    """Return the A-line counts of an abandoned scan, from its local file or the object store.

    Where its file is lost with the host that wrote it, what was kept of it before counts from now on, for everybody;
    nothing is counted where that is lost or damaged too.

    Parameters
    ----------
    own
        Where its file is, if it is on this host.

    Raises
    ------
    StoreUnavailable
        When what is kept cannot be had now.
    """
    if own.exists():
        return count_alines(own)
    arrays.accept_stale_copy(name := scan_name(scan_id))
    try:
        return count_alines(arrays.open(name))
    except (NotFound, DamagedFile):
        return {}


def count_alines(path: Path) -> dict[str, Any]:
    """Return the counts of a scan file (``points``, ``stored``, ``fired``); empty without a readable file."""
    try:
        with open_for_reading(path) as file:
            status = np.asarray(file["alines/status"])
            stored = int((status == schema.STORED).sum())
            return {"points": len(status), "stored": stored, "fired": int(file["fired"][()])}
    except (OSError, *HDF5_ERRORS):
        return {}
