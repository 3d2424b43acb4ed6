"""Disk quota: free space, reserve, and bytes reserved for unfinished scans and jobs."""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from sqlalchemy import ColumnElement, false, or_, select
from sqlalchemy.orm import Session

from steradian.core.exceptions import DiskFull
from steradian.plans.preview import BYTES_PER_ALINE, BYTES_PER_SAMPLE
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.tables import JobRow, PlanRow, ScanRow
from steradian.storage.state_machines import ReconstructionState

QUOTA_LOCK = 0x57E2AD1C
"""Number of the PostgreSQL advisory lock under which jobs are let in."""


@dataclass(frozen=True)
class DiskQuota:
    """Disk quota of a data directory: reserve of free space and limit of use.

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
        """Free bytes of the disk."""
        return shutil.disk_usage(self.folder).free

    @property
    def used(self) -> int:
        """Bytes used by all files of the data directory."""
        return size_of(self.folder)

    def require(self, need: int, what: str, promised: int, used: int) -> None:
        """Raise :class:`DiskFull` if work needs more bytes than are available and not reserved.

        Parameters
        ----------
        need
            Bytes.
        what
            Who needs them, in the words of the refusal.
        promised
            Bytes that others will take, who were told that they may.
        used
            Bytes that the folder holds; of no importance without a quota.

        Raises
        ------
        DiskFull
            With what is needed, what is there and what of it is promised.
        """
        if need <= (available := max(0, self.available(used) - promised)):
            return
        text = (
            f"{what} needs {need / 1e6:.1f} MB; the disk has {self.free / 1e6:.1f} MB free, of which "
            f"{self.reserve / 1e6:.1f} MB stay free and {promised / 1e6:.1f} MB are reserved for other work"
        )
        if self.quota is not None:
            text += f"; of the quota (quota_bytes), {self.quota / 1e6:.1f} MB, {used / 1e6:.1f} MB are in use"
        raise DiskFull(text, needed=need, available=available, promised=promised)

    def available(self, used: int) -> int:
        """Return the bytes available to uploads and jobs, given the bytes used by the data directory."""
        free = self.free - self.reserve
        return max(0, free if self.quota is None else min(free, self.quota - used))


@dataclass(frozen=True)
class BytesWritten:
    """Measured output of unfinished work: bytes per running job, and scans with a file."""

    jobs: Mapping[str, int]
    scans: frozenset[str]


@dataclass(frozen=True)
class UsageSnapshot:
    """Measurement of a data folder: bytes used, start time, and bytes of uploads received by then."""

    used: int
    at: datetime
    came: int
    """Bytes of uploads."""
    written: BytesWritten


class UploadReservations:
    """Reservations of disk space for concurrent uploads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.came = self.awaited = 0
        """Bytes that have come of all uploads that were not given up, and that are stated and have not come."""

    @contextmanager
    def upload(
        self, stated: int, require: Callable[[int], object], *, kept: bool = False
    ) -> Iterator[Callable[[int], None]]:
        """Reserve disk space for an upload until it ends; its bytes count as used if it succeeds.

        Parameters
        ----------
        stated
            Bytes that it says it has; 0 where it does not.
        require
            Refuses a number of bytes, beside what :attr:`came` and is :attr:`awaited`; called one at a time.
        kept
            Whether what came of an upload that breaks off stays on the disk.

        Yields
        ------
        Callable
            To be told of a number of bytes before they are written.
        """
        size, left = 0, stated

        def take(count: int) -> None:
            nonlocal size, left
            with self._lock:
                own = min(count, left)
                self.awaited -= own
                left -= own
                require(count)
                self.came += count
            size += count

        with self._lock:
            require(stated)
            self.awaited += stated
        try:
            yield take
        except BaseException:
            with self._lock:
                self.came -= 0 if kept else size
            raise
        finally:
            with self._lock:
                self.awaited -= left


def scan_bytes(plan: PlanRow) -> int:
    """Return the size in bytes of the scan file that a plan produces."""
    samples: int = plan.preview["bytes"]
    alines: int = samples // (plan.parameters["samples"] * BYTES_PER_SAMPLE)
    return samples + alines * BYTES_PER_ALINE


def reserved_bytes(
    session: Session, data: DataDirectory, measured: UsageSnapshot | None = None, scanner_id: str | None = None
) -> int:
    """Return the reserved bytes that unfinished scans and jobs have not yet written.

    A scan's file has its full size from the start.

    Parameters
    ----------
    measured
        What the folder held when it was looked at: what was written since is not in there, and so still promised.
    scanner_id
        Only what the scans of this scanner will write: of a node whose jobs are others' to do.
    """
    before = bytes_written(session, data) if measured is None else measured.written
    jobs = select(JobRow.id, JobRow.promised).where(_unfinished(JobRow, measured), JobRow.promised > 0)
    scans = (
        select(ScanRow.id, PlanRow).join(PlanRow, PlanRow.id == ScanRow.plan_id).where(_unfinished(ScanRow, measured))
    )
    if scanner_id is not None:
        jobs, scans = jobs.where(false()), scans.where(ScanRow.scanner_id == scanner_id)
    total = sum(scan_bytes(plan) for scan, plan in session.execute(scans) if scan not in before.scans)
    return total + sum(max(0, most - before.jobs.get(job_id, 0)) for job_id, most in session.execute(jobs))


def bytes_written(session: Session, data: DataDirectory) -> BytesWritten:
    """Measure the bytes that running jobs have written, and find unfinished scans with a file."""
    jobs = select(JobRow.id, JobRow.kind, JobRow.state).where(JobRow.ended.is_(None), JobRow.promised > 0)
    sizes = {}
    for job_id, kind, state in session.execute(jobs):
        if state is not ReconstructionState.QUEUED:
            sizes[job_id] = size_of(data.job(job_id).root)
            if kind == "import":  # it writes its scan where scans are
                scan = (data.root / "scans").glob(f"{imported_scan_id(job_id)}.h5*")
                sizes[job_id] += sum(map(_size, scan))
    scans = session.scalars(select(ScanRow.id).where(ScanRow.ended.is_(None)))
    return BytesWritten(sizes, frozenset(scan for scan in scans if data.scan_file(scan).exists()))


def _unfinished(row: type[JobRow] | type[ScanRow], measured: UsageSnapshot | None) -> ColumnElement[bool]:
    """Return the SQL condition that selects work that is unfinished or ended after the measurement."""
    return row.ended.is_(None) if measured is None else or_(row.ended.is_(None), row.ended > measured.at)


def imported_scan_id(job_id: str) -> str:
    """Return the identifier of the scan that an import job creates; the same for each attempt."""
    return f"s{job_id[1:]}"


def importing_job_id(scan_id: str) -> str:
    """Return the identifier of the import job that creates a scan with this identifier."""
    return f"j{scan_id[1:]}"


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def size_of(folder: Path) -> int:
    """Return the total size in bytes of all files below a folder."""
    total = 0
    for root, _, names in os.walk(folder):
        for name in names:
            with suppress(OSError):
                total += os.lstat(os.path.join(root, name)).st_size
    return total
