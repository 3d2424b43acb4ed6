"""The disk as a resource: what is free of it, what must stay free, and what jobs that are queued will write."""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import select
from sqlalchemy.orm import Session

from steradian.errors import DiskFull
from steradian.storage.paths import DataDirectory
from steradian.storage.states import ReconstructionState
from steradian.storage.tables import JobRow

ROOM_LOCK = 0x57E2AD1C
"""Number of the PostgreSQL advisory lock under which jobs are let in."""


@dataclass(frozen=True)
class Disk:
    """The disk under a data directory.

    Attributes
    ----------
    folder
        The data directory.
    reserve
        Bytes that uploads and jobs leave free, for the database, for logs and for scans under way.
    quota
        Bytes that the folder may hold, when an upload or a job comes; ``None``: as many as the disk.
    """

    folder: Path
    reserve: int
    quota: int | None = None

    @property
    def free(self) -> int:
        """Bytes that are free now."""
        return shutil.disk_usage(self.folder).free

    @property
    def used(self) -> int:
        """Bytes that all files of the folder hold."""
        return size_of(self.folder)

    @property
    def available(self) -> int:
        """Bytes that uploads and jobs may take."""
        return self._available(self.used if self.quota is not None else 0)

    def require(self, need: int, what: str, promised: int = 0, used: int | None = None) -> None:
        """Refuse what does not fit.

        Parameters
        ----------
        need
            Bytes.
        what
            Who needs them, in the words of the refusal.
        promised
            Bytes that others will take, who were told that they may.
        used
            Bytes that the folder holds, where that is known; else they are counted if there is a quota.

        Raises
        ------
        DiskFull
            With what is needed, what is there and what of it is promised.
        """
        if used is None:
            used = self.used if self.quota is not None else 0
        if need <= (available := max(0, self._available(used) - promised)):
            return
        text = (
            f"{what} needs {need / 1e6:.1f} MB; the disk has {self.free / 1e6:.1f} MB free, of which "
            f"{self.reserve / 1e6:.1f} MB stay free and {promised / 1e6:.1f} MB are promised to jobs that wait or run"
        )
        if self.quota is not None:
            text += f"; of the quota (quota_bytes), {self.quota / 1e6:.1f} MB, {used / 1e6:.1f} MB are in use"
        raise DiskFull(text, needed=need, available=available, promised=promised)

    def _available(self, used: int) -> int:
        free = self.free - self.reserve
        return max(0, free if self.quota is None else min(free, self.quota - used))


def promised(session: Session, data: DataDirectory) -> int:
    """Return the bytes that jobs which wait or run will still write, by what they were let in with."""
    query = select(JobRow.id, JobRow.state, JobRow.promised).where(JobRow.ended.is_(None), JobRow.promised > 0)
    total = 0
    for job_id, state, most in session.execute(query):
        there = 0 if state is ReconstructionState.QUEUED else size_of(data.job(job_id).root)
        total += max(0, most - there)
    return total


def size_of(folder: Path) -> int:
    """Add up the bytes of all files below a folder; what goes meanwhile does not count."""
    total = 0
    for root, _, names in os.walk(folder):
        for name in names:
            with suppress(OSError):
                total += os.lstat(os.path.join(root, name)).st_size
    return total
