"""Migration of finished scans and jobs between the local folder and the object store; restartable."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from steradian.core.atomic_files import atomic_write, sync_folder
from steradian.core.exceptions import Conflict, DamagedFile, NotFound
from steradian.core.progress import Progress
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.runtime.archive.scan_uploader import upload_scan
from steradian.storage.blobs.interface import result_name, scan_name, upload_name
from steradian.storage.blobs.object_store import S3BlobStore
from steradian.storage.data_dir.job_directory import LOG
from steradian.storage.data_dir.layout import PRIVATE_MODE, DataDirectory
from steradian.storage.db.database import Database
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import is_terminal

STAGE: Final = "moving"


def move_to_store(store: S3BlobStore, database: Database, data: DataDirectory, progress: Progress) -> int:
    """Move the files of finished scans and jobs to the object store; return the number of files.

    Files of unfinished scans and jobs, and files without a database row, stay. Each local file is removed only after
    the object was read back.

    Raises
    ------
    DamagedFile
        When an object differs from its file.
    """
    found = list(_finished(database, data))
    for number, (name, path) in enumerate(found):
        progress(STAGE, number, len(found))
        row = store.find_row(name)
        if row is None or row.sha256 != _sha256(path):  # a scan that was resumed has the same size
            upload_scan(store, data, name, path)
        if not store.is_whole(name):
            raise DamagedFile(f"{name} reads otherwise from the store than it was written; it stays in the folder")
        path.unlink()
    for folder in data.job_folders():
        if _is_over(JobLedger(database), folder.name):
            shutil.rmtree(folder)
    return len(found)


def move_to_folder(store: S3BlobStore, data: DataDirectory, progress: Progress) -> int:
    """Copy all objects from the store to the data folder, then delete them in the store; return their number.

    Raises
    ------
    Conflict
        When the folder has another file of that name; nothing is deleted then.
    DamagedFile
        When an object does not match its checksum; nothing is deleted then.
    """
    rows = store.rows()
    for number, row in enumerate(rows):
        progress(STAGE, number, len(rows))
        target = data.root.absolute() / row.name
        if target.is_file():
            # A scan's own file is at least as new as what was kept of it: it may have been resumed since.
            if not row.name.startswith("scans/") and _sha256(target) != row.sha256:
                raise Conflict(f"{row.name} in {data.root} is another file than the store's")
            continue
        target.parent.mkdir(mode=PRIVATE_MODE, parents=True, exist_ok=True)
        with atomic_write(target) as beside:
            shutil.copyfile(store.open(row.name), beside)
            if _sha256(beside) != row.sha256:
                raise DamagedFile(f"{row.name} is not as it was stored; it stays in the store")
            with beside.open("rb+") as file:
                os.fsync(file.fileno())
            os.utime(beside, (row.created.timestamp(), row.created.timestamp()))
        sync_folder(target.parent)
    store.purge()
    return len(rows)


def _finished(database: Database, data: DataDirectory) -> Iterator[tuple[str, Path]]:
    """Yield blob name and path of each file of finished scans, finished jobs and uploads."""
    scans, ledger = ScanRepository(database), JobLedger(database)
    for path in data.scan_files():
        if _is_over(scans, path.stem):
            yield scan_name(path.stem), path
    for folder in data.job_folders():
        if _is_over(ledger, folder.name):
            job = data.job(folder.name)
            yield from ((result_name(folder.name, path.name), path) for path in job.results())
            for path in sorted(folder.glob(f"{LOG}*.txt")):
                yield result_name(folder.name, f"{LOG}-0000.txt" if path == job.log else path.name), path
    for path in sorted(data.uploads.iterdir()):
        if not path.suffix:
            yield upload_name(path.name), path


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _is_over(rows: ScanRepository | JobLedger, identifier: str) -> bool:
    try:
        return is_terminal(rows.get(identifier).state)
    except NotFound:
        return False
