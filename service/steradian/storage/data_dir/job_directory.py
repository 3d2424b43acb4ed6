"""Folder of one job: result files, log, run lock and fencing token."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import filelock

from steradian.core.atomic_files import DRAFT_SUFFIX, remove_drafts
from steradian.core.exceptions import Conflict, StaleFence

VOLUME, SERIES, REVISION, PROJECTIONS, LOG = "volume.h5", "series.h5", "revision.json", "projections.h5", "log"
"""Names of what jobs leave; a log's begins so."""


def mip(axis: str) -> str:
    """Return the file name of the PNG of the maximum-intensity projection along an axis."""
    return f"mip-{axis}.png"


class StillRunning(Conflict):
    """Error: another process still runs the job."""

    code = "still-running"


@dataclass(frozen=True)
class JobDirectory:
    """Folder of a job: its results, log and locks."""

    root: Path

    @property
    def log(self) -> Path:
        """Path of the job's log file, with the output of all attempts."""
        return self.root / f"{LOG}.txt"

    @property
    def volume(self) -> Path:
        """Path of the HDF5 file with the reconstructed volume."""
        return self.root / VOLUME

    @property
    def report(self) -> Path:
        """Path of the JSON file with the job's figures and provenance."""
        return self.root / "report.json"

    @property
    def revision(self) -> Path:
        """Path of the JSON file about the newest revision of a live reconstruction."""
        return self.root / REVISION

    def results(self) -> list[Path]:
        """Return the paths of the job's result files, without log and internal files."""
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
        """Store the number of a new attempt as the fencing token, which invalidates earlier attempts.

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
        """Raise :class:`StaleFence` if a later attempt of the job has started."""
        if (newest := self.latest_attempt) > start:
            raise StaleFence(f"start {start} of job {self.root.name} counts no more; start {newest} has begun")

    @property
    def latest_attempt(self) -> int:
        """Number of the newest attempt (fencing token); 0 before the first or if its file is damaged."""
        with suppress(OSError, ValueError):
            return int(self._start.read_text())
        return 0

    @property
    def _start(self) -> Path:
        return self.root / "start"

    @contextmanager
    def hold_running_lock(self, timeout: float = 10.0) -> Iterator[None]:
        """Hold the job's run lock until the block ends; waits for an earlier attempt to exit.

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
        """Whether a process holds the job's run lock."""
        if not (self.root / "lock").exists():
            return False
        lock = filelock.FileLock(self.root / "lock")
        try:
            lock.acquire(timeout=0)
        except filelock.Timeout:
            return True
        lock.release()
        return False
