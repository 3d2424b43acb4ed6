"""Upload of finished scans to the object store, and removal of the local files after a grace period."""

from __future__ import annotations

import logging
import os
import shutil
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from sqlalchemy import select
from sqlalchemy.exc import SQLAlchemyError

from steradian.core.exceptions import NotFound, StoreUnavailable
from steradian.core.logging_config import bind_request_id
from steradian.storage.blobs.interface import StagedBlob, scan_name
from steradian.storage.blobs.object_store import CLOCK_SKEW, S3BlobStore
from steradian.storage.blobs.outdated_scan_copy import is_stale
from steradian.storage.data_dir.layout import PRIVATE_MODE, DataDirectory
from steradian.storage.db.tables import ScanRow
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import ScanState, is_terminal

POLL_INTERVAL: Final = 1.0
"""Seconds between looks at the scans of this host."""
LOCAL_RETENTION: Final = 600.0
"""Seconds for which the file of a scan that is kept stays: who has begun to read it may end."""
STAGING_FOLDER: Final = "keeping"
"""Folder of what is being sent, beside the copies."""
_log = logging.getLogger(__name__)


class ScanUploader:
    """Background uploader of finished and interrupted scans to the object store.

    Parameters
    ----------
    store
        Object store.
    scans
        Repository with the states of the scans.
    data
        Data directory with the local scan files.
    """

    def __init__(self, store: S3BlobStore, scans: ScanRepository, data: DataDirectory) -> None:
        self._store, self._scans, self._data = store, scans, data
        self._sent: dict[str, float] = {}
        """When scans came to the store, which may be long after the time as of which they are kept."""
        self._known: set[str] = set()
        """Scans of files that are here, last seen at rest: one that another node deletes then takes its file along.

        One under way cannot be deleted: where its row is gone, a database was set back, and the file is all there is.
        """

    def run(self, stopping: threading.Event) -> None:
        """Upload scans until ``stopping`` is set, retrying while store or database are unavailable."""
        for left in (self._data.cache / STAGING_FOLDER).glob("*"):  # by a process that was killed
            left.unlink(missing_ok=True)
        while not stopping.wait(POLL_INTERVAL):
            try:
                self.step()
            except (StoreUnavailable, SQLAlchemyError, OSError) as error:
                _log.warning("scans are not stored yet; retrying: %s", error)
            except Exception:  # nobody else would notice that this thread has ended
                _log.exception("scans are not stored yet; retrying")

    def step(self) -> None:
        """Check all local scan files once: upload new versions, and remove files whose retention has passed."""
        for path in self._data.scan_files():
            try:
                scan = self._scans.get(path.stem)
            except NotFound:
                if path.stem in self._known:
                    path.unlink(missing_ok=True)
                continue
            if not (is_terminal(scan.state) or scan.state is ScanState.INTERRUPTED):
                self._known.discard(scan.id)
                continue
            self._known.add(scan.id)
            if path.is_symlink():
                continue
            kept, changed = self._store.find_row(scan_name(scan.id)), path.stat().st_mtime
            # Without a change, too: what was resumed in vain is to count again where its file is not.
            if kept is None or changed > kept.created.timestamp() + CLOCK_SKEW or is_stale(scan, kept):
                self._keep(scan, path)
            elif (
                is_terminal(scan.state)
                and time.time() - self._sent.get(scan.id, kept.created.timestamp()) > LOCAL_RETENTION
            ):
                path.unlink()
                self._sent.pop(scan.id, None)

    def _keep(self, scan: ScanRow, path: Path) -> None:
        """Upload the file of a finished scan, or a copy of the file of an interrupted one."""
        as_of = self._scans.clock()
        with _draft(self._data) as draft:
            if is_terminal(scan.state):
                os.link(path, draft)
            else:
                shutil.copy2(path, draft)
            if self._announce(scan, self._store.put(scan_name(scan.id), draft, as_of)):
                self._sent[scan.id] = time.time()
                with bind_request_id(scan.request_id):
                    _log.info("scan %s is in the store", scan.id)

    def _announce(self, scan: ScanRow, stored: StagedBlob) -> bool:
        """Commit an uploaded file unless the scan was deleted, resumed or ended meanwhile; return whether it was.

        An uncommitted object is removed later as an orphan.
        """
        with self._scans.database.write() as session:
            now = session.scalar(select(ScanRow.revision).where(ScanRow.id == scan.id).with_for_update())
            if now is None or not (is_terminal(scan.state) or now == scan.revision):
                return False
            self._store.commit(session, stored)
        return True


def upload_scan(store: S3BlobStore, data: DataDirectory, name: str, path: Path) -> None:
    """Upload a finished file to the object store without removing the local file."""
    with _draft(data) as draft:
        os.link(path, draft)
        store.put_and_commit(name, draft)


@contextmanager
def _draft(data: DataDirectory) -> Iterator[Path]:
    """Yield the path of a temporary file in the cache folder, removed at the end of the block."""
    folder = data.cache / STAGING_FOLDER
    folder.mkdir(mode=PRIVATE_MODE, parents=True, exist_ok=True)
    draft = folder / f"{os.getpid()}-{threading.get_ident()}"
    draft.unlink(missing_ok=True)
    try:
        yield draft
    finally:
        draft.unlink(missing_ok=True)
