"""Files of one job and the fencing token of its current attempt."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import filelock

from steradian.core.atomic_files import DRAFT_SUFFIX, remove_drafts
from steradian.core.exceptions import Conflict, StaleFence

VOLUME, REVISION, PROJECTIONS, LOG = "volume.h5", "revision.json", "projections.h5", "log"
"""Names of what jobs leave; a log's begins so."""


def mip(axis: str) -> str:
    """Name of the PNG of the maximum-intensity projection along an axis."""
    return f"mip-{axis}.png"


class StillRunning(Conflict):
    """Another process is at a job."""

    code = "still-running"


@dataclass(frozen=True)
class JobDirectory:
    """Folder of a job: its results, log and locks."""

    root: Path

    @property
    def log(self) -> Path:
        """Log file of the job and its worker, for all attempts."""
        return self.root / f"{LOG}.txt"

    @property
    def volume(self) -> Path:
        """The volume as HDF5."""
        return self.root / VOLUME

    @property
    def report(self) -> Path:
        """Figures and provenance."""
        return self.root / "report.json"

    @property
    def revision(self) -> Path:
        """Figures of the newest image of a scan that is being followed."""
        return self.root / REVISION

    def results(self) -> list[Path]:
        """Return the result files of the job, without its log and internal files."""
        own = ("start", "lock", LOG)
        return sorted(
            path
            for path in self.root.iterdir()
            if path.is_file()
            and not path.is_symlink()
            and not path.name.startswith(own)
            and DRAFT_SUFFIX not in path.name
        )

    def begin_attempt(self, start: int) -> None:
        """Note that a start of the job has begun; an earlier one that still lives somewhere then counts no more.

        Raises
        ------
        StaleFence
            When a later one has begun already.
        """
        self.root.mkdir(parents=True, exist_ok=True)
        self.check_fence(start)
        draft = self._start.with_name(f"start.{start}")
        draft.write_text(str(start))
        draft.replace(self._start)

    def check_fence(self, start: int) -> None:
        """Raise :class:`StaleFence` when a later start of the job has begun."""
        if (newest := self.latest_attempt) > start:
            raise StaleFence(f"start {start} of job {self.root.name} counts no more; start {newest} has begun")

    @property
    def latest_attempt(self) -> int:
        """Number of the newest start; 0 before the first, and where a power cut has emptied the note of it."""
        with suppress(OSError, ValueError):
            return int(self._start.read_text())
        return 0

    @property
    def _start(self) -> Path:
        return self.root / "start"

    @contextmanager
    def hold_running_lock(self, timeout: float = 10.0) -> Iterator[None]:
        """Mark the job as running in this process; waits for an earlier attempt that is still dying.

        Raises
        ------
        StillRunning
            When another process runs the job and does not end within ``timeout`` seconds.
        """
        self.root.mkdir(parents=True, exist_ok=True)
        lock = filelock.FileLock(self.root / "lock")
        try:
            lock.acquire(timeout=timeout)
        except filelock.Timeout:
            raise StillRunning(f"another process still runs job {self.root.name}") from None
        try:
            remove_drafts(self.root)  # what earlier starts left
            yield
        finally:
            lock.release()

    @property
    def is_running(self) -> bool:
        """Whether a process runs the job at this moment."""
        if not (self.root / "lock").exists():
            return False
        lock = filelock.FileLock(self.root / "lock")
        try:
            lock.acquire(timeout=0)
        except filelock.Timeout:
            return True
        lock.release()
        return False
