"""Creation of a consistent backup while the service runs.

The rows are read first, as of one moment; the files follow. Those hold at least what the rows say, because files come
before their rows: an A-line before it is counted, a volume before its job has succeeded. Whatever was made after the
moment is left out, and what a job has not finished: it runs again. If something was deleted before it could be copied,
the rows are read once more, and only what is new is copied.
"""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from sqlalchemy import create_engine, select
from sqlalchemy.exc import DBAPIError
from sqlalchemy.orm import Session

from steradian.core.atomic_files import DRAFT_SUFFIX, atomic_write, sync_folder
from steradian.core.exceptions import Conflict, DamagedFile, DiskFull, InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.runtime.backups.lock import exclusive
from steradian.runtime.backups.manifest import (
    DATABASE,
    CopyProgress,
    Entry,
    Manifest,
    copy_file,
    hash_file,
    regular_files,
)
from steradian.scans.file.aline_metadata import ShotTable
from steradian.scans.file.create import is_disk_full_error
from steradian.scans.file.h5py_errors import HDF5_ERRORS
from steradian.scans.file.locking import open_for_reading
from steradian.scans.file.verify import verify_scan_file
from steradian.storage.data_dir.layout import PRIVATE_MODE, DataDirectory
from steradian.storage.data_dir.sqlite_urls import sqlite_url
from steradian.storage.db.database import Database, known_revisions
from steradian.storage.db.tables import JobRow, ScanRow
from steradian.storage.maintenance.snapshot import take_snapshot
from steradian.storage.repositories.imports import imported_scan_id
from steradian.storage.state_machines import ScanState, is_terminal

MAX_ROUNDS: Final = 20
"""Times that the rows are read before too much is being deleted."""
MAX_TRIES: Final = 3
"""Times that a scan file is copied in which A-lines are being replaced."""
STOP: Final = ("pressed", "released", "answered")


def create_backup(
    data: DataDirectory,
    database: Database,
    destination: Path,
    *,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Manifest:
    """Create a backup of database and files in a new folder, also while the service runs.

    The folder is renamed to its final name when all files are complete and synced.

    Parameters
    ----------
    database
        Database of the data folder, with the current schema.
    progress
        Callback for the progress in bytes.

    Raises
    ------
    Cancelled
        When ``cancelled`` returns true; the incomplete backup is removed.
    Conflict
        When the destination exists or another backup to it is under way, or more is being deleted than can be copied.
    DiskFull
        When the destination cannot hold it.
    InvalidInput
        When the destination lies in the data folder.
    """
    destination = destination.absolute()
    if destination.resolve().is_relative_to(data.root.resolve()):
        raise InvalidInput("destination", destination, f"a place outside the data folder {data.root}")
    destination.parent.mkdir(parents=True, exist_ok=True)
    under_way = f"another backup to {destination} is under way"
    with exclusive(destination.with_name(f"{destination.name}.lock"), under_way), _draft(destination) as folder:
        folder.mkdir(mode=PRIVATE_MODE)
        manifest = _Copy(data, database, folder, progress, cancelled).run()
        manifest.write(folder)
        for each in {folder, *(path.parent for path in regular_files(folder))}:
            sync_folder(each)
    sync_folder(destination.parent)
    return manifest


@contextmanager
def _draft(destination: Path) -> Iterator[Path]:
    if destination.exists():
        raise Conflict(f"{destination} exists; a backup is a new folder")
    try:
        with atomic_write(destination) as folder:
            yield folder
    except (OSError, sqlite3.Error, DBAPIError) as error:  # somebody else fills the disk meanwhile
        if (isinstance(error, OSError) and is_disk_full_error(error)) or "disk is full" in str(error):
            raise DiskFull(f"the disk of {destination.parent} became full; no part of the backup is kept") from error
        raise


@dataclass
class _SnapshotIndex:
    """Identifiers of scans and jobs in a database snapshot, which decide the files to copy."""

    finished: set[str]
    scans: set[str]
    over: set[str]
    jobs: set[str]
    imports: set[str]
    """Scans that imports under way will make."""
    awaited: set[str]
    """Uploads that imports have still to read, by their paths."""

    @classmethod
    def of(cls, path: Path) -> _SnapshotIndex:
        engine = create_engine(sqlite_url(path, "destination"))
        with Session(engine) as session:
            scans = session.execute(select(ScanRow.id, ScanRow.state)).all()
            jobs = session.execute(select(JobRow.id, JobRow.state, JobRow.kind, JobRow.payload)).all()
        engine.dispose()
        imports = [job for job in jobs if job.kind == "import" and not is_terminal(job.state)]
        named = [job.payload.get(name) for job in imports for name in ("upload_id", "companion_id")]
        return cls(
            finished={scan.id for scan in scans if scan.state is ScanState.COMPLETE},
            scans={scan.id for scan in scans},
            over={job.id for job in jobs if is_terminal(job.state)},
            jobs={job.id for job in jobs},
            imports={imported_scan_id(job.id) for job in imports},
            awaited={f"uploads/{name}" for name in named if name is not None},
        )

    def includes(self, path: str, before: set[str]) -> bool:
        """Return whether a file belongs in the backup: of an indexed resource, or present before the snapshot."""
        kind, _, rest = path.partition("/")
        name, _, within = rest.partition("/")
        if kind == "scans":
            scan = name.removesuffix(".h5")
            return scan in self.scans or (path in before and scan not in self.imports)
        if kind == "jobs":
            return name in self.over or (within == "log.txt" if name in self.jobs else path in before)
        return True


@dataclass
class _Copy:
    data: DataDirectory
    database: Database
    folder: Path
    progress: Progress | None
    cancelled: CancelCheck | None
    copied: dict[str, tuple[tuple[int, int], Entry]] = field(default_factory=dict)
    damaged: dict[str, str] = field(default_factory=dict)

    def run(self) -> Manifest:
        """Copy database and files, repeating until no file was deleted meanwhile, and return the manifest."""
        gone: set[str] = set()
        for _ in range(MAX_ROUNDS):
            made, before = datetime.now(UTC).isoformat(timespec="seconds"), set(self._files())
            rows_size = self._size_of_rows()
            self._require(rows_size, rows_size + sum(size for size, _ in filter(None, map(self._new, before))))
            take_snapshot(self.database, self.folder / DATABASE)
            rows = _SnapshotIndex.of(self.folder / DATABASE)
            wanted = {path for path in self._files() if rows.includes(path, before)}
            self._copy_all(wanted, rows)
            known, gone = gone, {path for path in before | rows.awaited if not (self.data.root / path).exists()}
            if gone <= known:
                break
        else:
            raise Conflict("more is being deleted than can be copied; try again when less is")
        self._drop(set(self.copied) - wanted)
        files = {path: entry for path, (_, entry) in self.copied.items()}
        files[DATABASE] = hash_file(self.folder / DATABASE)
        return Manifest(made, known_revisions()[0], len(rows.scans), len(rows.jobs), self.damaged, files)

    def _files(self) -> Iterator[str]:
        """Yield the paths of the data folder's files, except temporary files, caches and heartbeats."""
        found = [self.data.identity_file, *(self.data.emergency / name for name in STOP)]
        found += [path for path in self.data.scan_files() if not path.is_symlink()]
        found += [path for path in self.data.uploads.glob("*") if path.suffix != ".part"]
        found += [path for path in regular_files(self.data.root.absolute() / "jobs") if path.name != "lock"]
        for path in found:
            if path.is_file() and DRAFT_SUFFIX not in path.name:
                yield path.relative_to(self.data.root.absolute()).as_posix()

    def _copy_all(self, wanted: set[str], rows: _SnapshotIndex) -> None:
        stamps = {path: stamp for path in sorted(wanted) if (stamp := self._new(path)) is not None}
        total = sum(size for size, _ in stamps.values())
        self._require(total)
        tick = CopyProgress(total, self.progress, self.cancelled)
        for path, stamp in stamps.items():
            with suppress(FileNotFoundError):  # deleted since, which is seen afterwards
                scan = Path(path).stem if path.startswith("scans/") else ""
                grows = scan in rows.scans - rows.finished
                entry = self._copy_growing(path, scan, tick) if grows else self._copy(path, tick)
                self.copied[path] = stamp, entry

    def _new(self, path: str) -> tuple[int, int] | None:
        """Return size and modification time of a file that is new or changed since its copy, else ``None``."""
        try:
            about = (self.data.root / path).stat()
        except FileNotFoundError:
            return None
        stamp = about.st_size, about.st_mtime_ns
        return None if path in self.copied and self.copied[path][0] == stamp else stamp

    def _copy(self, path: str, tick: CopyProgress) -> Entry:
        return copy_file(self.data.root / path, self.folder / path, tick)

    def _copy_growing(self, path: str, scan: str, tick: CopyProgress) -> Entry:
        """Copy a scan file that may be written meanwhile; half-written A-lines count as missing.

        An A-line that is written during the copy may be missing from this backup; the next backup contains it.
        """
        self.damaged.pop(scan, None)
        try:
            for _ in range(MAX_TRIES):
                with open_for_reading(self.data.root / path) as file:
                    stored = ShotTable.of_file(file).stored
                self._copy(path, tick)
                if not (lost := int(stored[verify_scan_file(self.folder / path).damaged].sum())):
                    break
            else:
                self.damaged[scan] = f"{lost} A-lines do not match their checksums and count as missing"
        except FileNotFoundError:
            raise
        except (DamagedFile, OSError, *HDF5_ERRORS) as error:
            self._copy(path, tick)
            self.damaged[scan] = f"cannot be read as a scan and is kept as it is ({error})"
        return hash_file(self.folder / path)

    def _size_of_rows(self) -> int:
        """Return the size in bytes of the SQLite files; 0 for a server database."""
        name = self.database.name
        files = [Path(name), Path(f"{name}-wal")] if self.database.is_file else []
        size = 0
        for file in files:
            with suppress(FileNotFoundError):  # the log goes when the last one closes the database
                size += file.stat().st_size
        return size

    def _require(self, size: int, whole: int | None = None) -> None:
        """Raise :class:`DiskFull` if the disk has less than ``size`` bytes free; ``whole`` is the backup's size."""
        free, whole = shutil.disk_usage(self.folder).free, max(size, whole or 0)
        if size > free:
            text = (
                f"the backup needs {whole / 1e6:.1f} MB; the disk of {self.folder.parent} has {free / 1e6:.1f} MB free"
            )
            raise DiskFull(text, needed=whole, available=free)

    def _drop(self, paths: set[str]) -> None:
        """Remove the copies of resources that were deleted during the backup."""
        for path in paths:
            (self.folder / path).unlink()
            del self.copied[path]
