"""Execution context of a job: data directory, working folder, plan cache, progress callback and blob store."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from steradian.core.exceptions import NotFound, StoreUnavailable
from steradian.core.progress import Progress
from steradian.storage.blobs.interface import BlobStore, FolderBlobStore, result_name, scan_name
from steradian.storage.data_dir.job_directory import SERIES, VOLUME
from steradian.storage.data_dir.layout import DataDirectory

if TYPE_CHECKING:
    from steradian.reconstructions.pipeline.plan_cache import PlanCache
    from steradian.storage.db.database import Database


@dataclass(frozen=True)
class JobContext:
    """Context that a job handler receives: folders, principal, plan cache, progress callback and blob store.

    Attributes
    ----------
    data, folder
        The data directory, and the job's own folder in it, which has the job's name.
    principal
        Owner: the principal that requested the job.
    plans
        Cache of reconstruction plans of earlier jobs of this process.
    arrays
        Blob store with scans and results.
    """

    data: DataDirectory
    folder: Path
    principal: str
    plans: PlanCache
    progress: Progress
    arrays: BlobStore

    def scan_path(self, scan_id: str) -> Path:
        """Return the local path of a scan's file, downloaded from the object store if necessary.

        Raises
        ------
        NotFound
            When there is none.
        StoreUnavailable
            When it is to come: its acquisition still has it, on another host.
        """
        try:
            return self.arrays.open(scan_name(scan_id))
        except NotFound as error:
            if isinstance(self.arrays, FolderBlobStore):
                raise
            raise StoreUnavailable(f"the A-lines of scan {scan_id} are not in the store yet") from error

    def volume_path(self, reconstruction_id: str) -> Path:
        """Return the local path of a reconstruction's volume or series file; raises :class:`NotFound` without one."""
        with suppress(NotFound):
            return self.arrays.open(result_name(reconstruction_id, VOLUME))
        return self.arrays.open(result_name(reconstruction_id, SERIES))


@contextmanager
def open_database() -> Iterator[Database]:
    """Context manager with a connection to the service's database."""
    from steradian.core.settings import Settings
    from steradian.storage.db.database import Database, metadata_url

    database = Database(metadata_url(Settings.create()))
    try:
        yield database
    finally:
        database.close()


def result_files(folder: Path) -> list[str]:
    """Return the names of the result files in a job's folder."""
    kinds = {".json", ".png", ".h5", ".csv", ".npy"}
    return sorted(path.name for path in folder.iterdir() if path.suffix in kinds and path.is_file())
