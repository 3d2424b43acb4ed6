"""Restore of a verified backup into an empty data folder and database."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from steradian.core.atomic_files import remove, sync_folder, write_durably
from steradian.core.exceptions import Conflict, DamagedFile
from steradian.core.progress import CancelCheck, Progress
from steradian.core.settings import Settings
from steradian.runtime.backups.lock import exclusive
from steradian.runtime.backups.manifest import CHANGED, DATABASE, CopyProgress, Manifest, copy_file
from steradian.runtime.fsck import Inconsistency, check_consistency
from steradian.runtime.singleton_locks import hold_database_lock
from steradian.storage.data_dir.layout import PRIVATE_MODE, DataDirectory
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.maintenance.snapshot import assign_new_identity, require_empty, restore_snapshot

DRAFT: Final = "restoring.new"
LOCK: Final = "lock"
"""That of the data folder, so that no service begins in it meanwhile."""


def restore(
    source: Path,
    settings: Settings,
    *,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> list[Inconsistency]:
    """Restore a backup into the empty data folder and database of the settings.

    Folder and database get a new identifier, so that workers and clients of the original service reject them.
    Unfinished work continues as after a power cut: jobs run again, scans are interrupted.

    Returns
    -------
    list of Finding
        What ``steradian check`` finds: nothing, unless the service lacked it when the backup was made.

    Raises
    ------
    Cancelled
        When ``cancelled`` returns true; all restored files are removed.
    Conflict
        When the folder or the database is not empty or is in use.
    DamagedFile
        When the backup is incomplete, damaged or of a newer version.
    """
    manifest = Manifest.read(source)
    root = settings.data.absolute()
    with _empty_database(settings) as database, _staging_folder(root) as folder:
        tick = CopyProgress(manifest.size, progress, cancelled)
        for path, entry in manifest.files.items():
            try:
                copied = copy_file(source / path, folder / path, tick)
            except FileNotFoundError:
                raise DamagedFile(f"{source / path} is missing from the backup") from None
            if copied != entry:
                raise DamagedFile(f"{source / path} {CHANGED}")
        for each, _, _ in os.walk(folder):
            sync_folder(Path(each))
        found = _migrate_and_assign_identity(folder, settings, database)
        # The database last: beside files without one no service starts.
        for name in sorted(os.listdir(folder), key=lambda name: (name.endswith(".sqlite"), name)):
            (folder / name).rename(root / name)
        sync_folder(root)
    return found


@contextmanager
def _staging_folder(root: Path) -> Iterator[Path]:
    """Yield a temporary folder inside the empty target folder; it is removed at the end."""
    made = not root.exists()
    _require_empty(root)
    root.mkdir(mode=PRIVATE_MODE, parents=True, exist_ok=True)
    try:
        with exclusive(root / LOCK, f"{root} is in use: a service begins in it, or something is being restored to it"):
            _require_empty(root)
            folder = root / DRAFT
            remove(folder)  # of one that was killed
            folder.mkdir(mode=PRIVATE_MODE)
            try:
                yield folder
            finally:
                remove(folder)
    finally:
        if made:
            with suppress(OSError):  # it holds what was restored
                root.rmdir()


def _require_empty(root: Path) -> None:
    if root.exists() and {path.name for path in root.iterdir()} - {DRAFT, LOCK}:
        raise Conflict(f"{root} is not empty; a backup is restored to a new folder")


def _migrate_and_assign_identity(folder: Path, settings: Settings, database: Database | None) -> list[Inconsistency]:
    """Migrate the restored database and give database and folder a new identifier; return inconsistencies."""
    data = DataDirectory(folder)
    data.create()
    (folder / DATABASE).rename(data.metadata_file)
    embedded = Database(data.metadata_url)
    try:
        embedded.migrate()
        write_durably(data.identity_file, assign_new_identity(embedded))
    finally:
        embedded.close()
    found = check_consistency(settings.model_copy(update={"data": folder, "database_url": None}))
    if database is not None:
        restore_snapshot(data.metadata_file, database)
        data.metadata_file.unlink()
    return found


@contextmanager
def _empty_database(settings: Settings) -> Iterator[Database | None]:
    """Yield the empty PostgreSQL database to restore to, under the service lock; ``None`` with SQLite."""
    if settings.database_url is None:
        yield None
        return
    with hold_database_lock(settings):
        database = Database(metadata_url(settings))
        try:
            database.migrate()
            require_empty(database)
            yield database
        finally:
            database.close()
