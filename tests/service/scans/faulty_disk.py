"""A disk that fills up, fails and writes by halves under a real file, and that knows what of it was synchronised."""

import errno
import os
from contextlib import contextmanager


class FaultyDisk:
    """Stands between a program and one file: ``os.pwrite`` and ``os.fdatasync`` of it go through here.

    ``chance()`` names the next fault: an error number, ``"short"`` for a write of some of the bytes, or None.
    """

    def __init__(self, path, chance=lambda: None):
        self.path, self.chance = path, chance
        self.durable = bytearray(path.read_bytes())
        self.pending = []
        self._inode = path.stat().st_ino
        self._pwrite, self._fdatasync = os.pwrite, os.fdatasync

    def pwrite(self, handle, data, offset):
        if os.fstat(handle).st_ino != self._inode:
            return self._pwrite(handle, data, offset)
        fault = self.chance()
        if isinstance(fault, int):
            raise OSError(fault, os.strerror(fault))
        data = bytes(data[: -(-len(data) // 2)] if fault == "short" else data)
        written = self._pwrite(handle, data, offset)
        self.pending.append((offset, data[:written]))
        return written

    def fdatasync(self, handle):
        if os.fstat(handle).st_ino != self._inode:
            return self._fdatasync(handle)
        fault = self.chance()
        if isinstance(fault, int):
            self.pending.clear()  # the system forgets them: a later synchronisation says well done
            raise OSError(fault, os.strerror(fault))
        self._fdatasync(handle)
        for offset, data in self.pending:
            self.durable[offset : offset + len(data)] = data
        self.pending.clear()
        return None

    @contextmanager
    def mounted(self, monkeypatch):
        with monkeypatch.context() as patch:
            patch.setattr(os, "pwrite", self.pwrite)
            patch.setattr(os, "fdatasync", self.fdatasync)
            yield self


FULL = errno.ENOSPC
BROKEN = errno.EIO
