"""Creation of a scan file from the A-lines of an earlier partial scan, for resumption under a new name."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from steradian.core.atomic_files import atomic_write, sync_folder
from steradian.core.exceptions import DiskFull, NotFound
from steradian.scans.file.create import check_free_space, is_disk_full_error


def create_from_partial(earlier: Path, path: Path, scan_id: str) -> None:
    """Create a scan file with the A-lines of an earlier partial scan, for :func:`.run.resume_scan`.

    Parameters
    ----------
    earlier
        A scan file that nobody writes to.
    path
        The new one; it appears when it is whole.
    scan_id
        Of the new scan; the file says besides which one it completes.

    Raises
    ------
    NotFound
        When the earlier file is gone.
    DiskFull
        When the disk cannot hold another one.
    """
    import h5py

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        check_free_space(path.parent, earlier.stat().st_size)
        with atomic_write(path) as beside:
            shutil.copyfile(earlier, beside)
            with h5py.File(beside, "r+") as file:
                file.attrs["completes"] = file.attrs["scan_id"]
                file.attrs["scan_id"] = scan_id
            with beside.open("rb") as raw:
                os.fsync(raw.fileno())
        sync_folder(path.parent)
    except FileNotFoundError as error:
        raise NotFound("file of scan", earlier.stem) from error
    except OSError as error:
        if is_disk_full_error(error):
            raise DiskFull(f"{path} cannot be begun, the disk is full") from error
        raise
