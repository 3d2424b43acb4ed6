"""Directory layout, permissions and lock of the data folder.

DATA/steradian.sqlite          metadata and job queue
DATA/identity                  says which database the folder belongs to
DATA/scans/<id>.h5             A-lines
DATA/uploads/<id>              files that came over HTTP and wait to be imported
DATA/pictures/<mask id>.png    pictures of masks, once they have been asked for
DATA/references/<scan id>-….h5 images of all A-lines, shared by jobs that compare with them, kept for a day
DATA/cache/                    copies of what an object store keeps, if there is one
DATA/jobs/<id>/                what one job left: a volume with projections and report, an export, its log
DATA/emergency-stop/           whether the stop is pressed (:mod:`steradian.storage.data_dir.emergency_latch`), key of
stop tickets DATA/run/<process>.json        heartbeats of the running processes
DATA/lock                      held by the service that owns the directory
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import filelock

from steradian.core.atomic_files import atomic_write
from steradian.core.exceptions import Conflict, InvalidInput
from steradian.storage.data_dir.job_directory import JobDirectory

FOLDERS: Final = ("scans", "uploads", "pictures", "references", "jobs", "run")
FILE_NAMES: Final = frozenset({*FOLDERS, "emergency-stop", "identity", "lock", "cache"})
DATABASE_FILE: Final = "steradian.sqlite"
PRIVATE_MODE: Final = 0o700
"""Mode of folders, and with :data:`UMASK` of all files: for this user alone."""
UMASK: Final = 0o077


class DataDirectoryInUse(Conflict):
    """Error: another service has locked the data directory."""

    code = "data-directory-in-use"


@dataclass(frozen=True)
class DataDirectory:
    """Paths of all files in a data directory, with its creation and lock."""

    root: Path

    @property
    def metadata_file(self) -> Path:
        """Path of the SQLite file with the metadata."""
        return self.root.absolute() / DATABASE_FILE

    @property
    def metadata_url(self) -> str:
        """SQLAlchemy URL of the SQLite file; raises :class:`InvalidInput` for a path that SQLite cannot open."""
        from steradian.storage.data_dir.sqlite_urls import sqlite_url  # loads SQLAlchemy, which most do not need

        return sqlite_url(self.metadata_file)

    @property
    def identity_file(self) -> Path:
        """Path of the file with the identifier that binds the folder to a database."""
        return self.root.absolute() / "identity"

    @property
    def identity(self) -> str | None:
        """Identifier that binds the folder to a database; ``None`` without the file or the folder."""
        try:
            return self.identity_file.read_text().strip() or None
        except OSError:
            return None

    def scan_file(self, scan_id: str) -> Path:
        """Return the path of the HDF5 file with the A-lines of a scan."""
        return self.root.absolute() / "scans" / f"{scan_id}.h5"

    def scan_files(self) -> list[Path]:
        """Return the paths of all scan files, including those without a database row."""
        return sorted((self.root.absolute() / "scans").glob("*.h5"))

    def scan_drafts(self) -> list[tuple[str, Path]]:
        """Return the temporary files beside the scan files, each with its scan's identifier."""
        found = (self.root.absolute() / "scans").glob("*.h5*")
        return [(path.name.partition(".")[0], path) for path in found if path.suffix != ".h5"]

    @property
    def uploads(self) -> Path:
        """Path of the folder of files uploaded over HTTP."""
        return self.root.absolute() / "uploads"

    def upload(self, upload_id: str) -> Path:
        """Return the path of a file uploaded over HTTP."""
        return self.uploads / upload_id

    def picture(self, mask_id: str) -> Path:
        """Return the path of the PNG image of a mask."""
        return self.root.absolute() / "pictures" / f"{mask_id}.png"

    @property
    def cache(self) -> Path:
        """Path of the folder of cached objects from the object store."""
        return self.root.absolute() / "cache"

    @property
    def references(self) -> Path:
        """Path of the folder of reference images that several jobs share."""
        return self.root.absolute() / "references"

    def reference(self, name: str) -> Path:
        """Return the path of a reference image that several jobs share."""
        return self.references / f"{name}.h5"

    def job(self, job_id: str) -> JobDirectory:
        """Return the folder of a job."""
        return JobDirectory(self.root.absolute() / "jobs" / job_id)

    def job_folders(self) -> list[Path]:
        """Return the folders of all jobs, including those without a database row."""
        return sorted(path for path in (self.root.absolute() / "jobs").glob("*") if path.is_dir())

    @property
    def emergency(self) -> Path:
        """Path of the folder of the emergency-stop latch."""
        return self.root.absolute() / "emergency-stop"

    @property
    def stop_secret(self) -> Path:
        """Path of the file with the key that signs stop tickets; not part of backups."""
        return self.emergency / "ticket-secret"

    def heartbeat(self, process: str) -> Path:
        """Return the path of a process's heartbeat file."""
        return self.root / "run" / f"{process}.json"

    def create(self) -> None:
        """Create the folders, accessible to this user only.

        Raises
        ------
        InvalidInput
            When the path is a file or cannot be written.
        """
        try:
            self.root.mkdir(mode=PRIVATE_MODE, parents=True, exist_ok=True)
            for folder in FOLDERS:
                (self.root / folder).mkdir(mode=PRIVATE_MODE, exist_ok=True)
        except OSError as error:
            raise InvalidInput("data", self.root, f"a folder that can be written ({error.strerror})") from error

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Hold the lock of the data directory until the block ends; the lock is released if the process is killed.

        Raises
        ------
        DataDirectoryInUse
            When another process owns it.
        """
        self.create()
        lock, owner = filelock.FileLock(self.root / "lock"), self.root / "run" / "owner.json"
        try:
            lock.acquire(timeout=0)
        except filelock.Timeout:
            raise DataDirectoryInUse(
                f"the data directory {self.root} is in use by process {_read_pid(owner)}; "
                "stop that service or choose another directory"
            ) from None
        try:
            with atomic_write(owner) as beside:
                beside.write_text(json.dumps({"pid": os.getpid()}))
            yield
        finally:
            owner.unlink(missing_ok=True)
            lock.release()

    def restrict_permissions(self) -> list[str]:
        """Remove other users' permissions on the folder's files, as a copy of it may have them.

        The folder itself is only changed when nothing else lies in it.

        Returns
        -------
        list of str
            What others can do all the same, "read /data/scans" for example.
        """
        if os.name != "posix":
            return []
        there = list(self.root.iterdir())
        ours = [path for path in there if path.name in FILE_NAMES or path.name.startswith(DATABASE_FILE)]
        for path in [*ours, self.root] if len(ours) == len(there) else ours:
            with suppress(PermissionError, FileNotFoundError):
                path.chmod(path.stat().st_mode & PRIVATE_MODE)
        still = [f"read {path}" for path in ours if _mode(path) & UMASK]
        return still + ([f"change {self.root}"] if self.root.stat().st_mode & UMASK & 0o222 else [])


def _mode(path: Path) -> int:
    """Return the permission bits of a file; 0 (no access) if the file no longer exists."""
    try:
        return path.stat().st_mode
    except FileNotFoundError:
        return 0


def _read_pid(path: Path) -> int | str:
    with suppress(OSError, ValueError):
        return int(json.loads(path.read_text())["pid"])
    return "unknown"
