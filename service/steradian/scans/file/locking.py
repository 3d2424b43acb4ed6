"""Single-writer, multiple-reader locking of scan files."""

from __future__ import annotations

import errno
import struct
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from steradian.core.exceptions import Conflict

if TYPE_CHECKING:
    import h5py

_FLOCK = "hhqqi"
"""The system's ``struct flock``: type, whence, start, length, process."""


def lock(handle: int, path: Path) -> None:
    """Lock a file for exclusive writing until it is closed; the lock ends when the process dies.

    The lock belongs to the open file and not to the process, and it is of another kind than the HDF5 library's: readers
    are not disturbed. On NFS both kinds are one, see :func:`open_for_reading`. Where there are no such locks, nothing
    is held.

    Raises
    ------
    Conflict
        When somebody else holds it.
    """
    if sys.platform != "linux":
        return
    import fcntl

    request = struct.pack(_FLOCK, fcntl.F_WRLCK, 0, 0, 0, 0)
    try:
        fcntl.fcntl(handle, fcntl.F_OFD_SETLK, request)
    except OSError as error:
        if error.errno in (errno.EAGAIN, errno.EACCES):
            raise Conflict(f"{path} is being written by another process") from error
        if error.errno not in (errno.EINVAL, errno.ENOLCK, errno.EOPNOTSUPP):
            raise


def open_for_reading(path: Path) -> h5py.File:
    """Open a scan file for reading, also while another process writes to it.

    The HDF5 library locks what it opens, and NFS makes of its lock one of the same kind as the writer's, which keeps
    every reader out, the writer's own included. The file's structure never changes while it is written and each row
    proves itself, so then it is opened without.

    Raises
    ------
    OSError
        When it is no HDF5 file or cannot be read.
    """
    import h5py

    try:
        return h5py.File(path, "r")
    except OSError:
        return h5py.File(path, "r", locking=False)
