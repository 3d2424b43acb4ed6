"""Blob store on S3: immutable objects, index of names in the database, local cache.

A key is ``<name>/<sha256>``. An object without a row is not there for anybody: it waits for its row, or is an orphan.
"""

from __future__ import annotations

import hashlib
import logging
import os
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path, PurePosixPath
from typing import Final
from uuid import uuid4

from sqlalchemy import delete, select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from steradian.core.exceptions import DamagedFile, InvalidInput, StoreUnavailable
from steradian.core.settings import Settings
from steradian.storage.blobs.cache import ContentCache
from steradian.storage.blobs.interface import BlobInfo, BlobStore, FolderBlobStore, StagedBlob
from steradian.storage.blobs.outdated_scan_copy import is_stale, last_write_started
from steradian.storage.blobs.s3 import TIMEOUT, S3Bucket
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.database import Database, advisory_xact_lock
from steradian.storage.db.tables import FactRow, ObjectRow, ScanRow
from steradian.storage.db.timestamps_and_ids import Clock, utc_now

ORPHAN_GRACE: Final = timedelta(days=1)
"""Age from which an object without a row is nobody's; much more than lies between an object and its row."""
AT_A_TIME: Final = 100
"""Objects that are swept while nothing is announced."""
SWEEP_LOCK: Final = 0x57E2AD1D
"""Number of the PostgreSQL advisory lock under which rows are written and orphans deleted."""
CLOCK_SKEW: Final = 1e-3
"""Seconds within which two times of files are the same."""
IDENTITY, FACT_KEY = "identity", "store"
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Contents:
    """Result of an audit of the object store: counts, missing or resized objects, and orphaned keys."""

    objects: int
    bytes: int
    missing: list[str]
    orphans: list[str]


class S3BlobStore:
    """Blob store on S3, with a local cache; files not yet uploaded are read from the data folder.

    Parameters
    ----------
    settings
        Settings with the store's URL; credentials come from the usual environment variables of S3.
    database
        Database with the names of the objects.

    Raises
    ------
    InvalidInput
        When the library for it is not installed.
    """

    def __init__(
        self, settings: Settings, database: Database, clock: Clock = utc_now, patience: timedelta = TIMEOUT
    ) -> None:
        self.place, self._database, self._clock = settings.store or "", database, clock
        data = DataDirectory(settings.data)
        self._folder, self._cache = FolderBlobStore(data), ContentCache(data.cache, settings.store_cache_bytes)
        self._bucket = S3Bucket(self.place, settings.store_endpoint, patience)
        self._at_once = S3Bucket(self.place, settings.store_endpoint, timedelta(0))

    def open(self, name: str) -> Path:
        """Return the path of a cached copy, downloaded if necessary, or of the local file if not yet uploaded."""
        row = self._row(name)
        if row is None:
            return self._folder.open(name)
        made = row.created.timestamp()
        return self._cache.get(_copy_of(row), row.size, made, lambda draft: self._fetch(row, draft))

    def put(self, name: str, file: Path, as_of: datetime | None = None) -> StagedBlob:
        """Upload a file and move it into the local cache; ``as_of`` is the time of its content (default: now)."""
        created = as_of or self._clock()  # before it is read, which takes a while
        with file.open("rb") as opened:
            sha256 = hashlib.file_digest(opened, "sha256").hexdigest()
        stored = StagedBlob(name, file.stat().st_size, created, sha256)
        if self._bucket.size(_key(stored)) != stored.size:
            self._bucket.create(_key(stored), file)
        self._cache.adopt(_copy_of(stored), file, stored.created.timestamp())
        return stored

    def commit(self, session: Session, *stored: StagedBlob) -> None:
        """Insert the database rows of uploaded objects; raises :class:`StoreUnavailable` if an object is missing."""
        advisory_xact_lock(session, SWEEP_LOCK)
        for each in stored:
            if self._bucket.size(_key(each)) != each.size:
                raise StoreUnavailable(f"the store has not all of {each.name}")
            session.merge(ObjectRow(name=each.name, sha256=each.sha256, size=each.size, created=each.created))

    def put_and_commit(self, name: str, file: Path) -> None:
        """Upload a file and insert its database row."""
        stored = self.put(name, file)
        with self._database.write() as session:
            self.commit(session, stored)

    def stat(self, name: str) -> BlobInfo | None:
        """Return size and time of a blob from its database row, or of a local file not yet uploaded."""
        row = self._row(name)
        return self._folder.stat(name) if row is None else BlobInfo(row.size, row.created.timestamp())

    def range(self, name: str, first: int, count: int) -> bytes:
        """Read bytes of a blob from the cached copy if there is one, else from S3."""
        row = self._row(name)
        if row is None:
            return self._folder.range(name, first, count)
        if (copy := self._cache.peek(_copy_of(row))) is not None:
            with copy.open("rb") as file:
                file.seek(first)
                return file.read(count)
        length = max(0, min(count, row.size - first))
        return self._bucket.range(_key(row), first, length) if length else b""

    def url(self, name: str, seconds: float) -> str | None:
        """Return a presigned URL of a blob; ``None`` for objects that are not stored yet."""
        row = self._row(name)
        return None if row is None else self._bucket.sign(_key(row), seconds)

    def list_names(self, beginning: str) -> Iterator[str]:
        """Yield the names of stored blobs and of local files not yet uploaded, sorted."""
        query = select(ObjectRow.name).where(ObjectRow.name.startswith(beginning, autoescape=True))
        with self._database.read() as session:
            known = set(session.scalars(query))
        yield from sorted(known | set(self._folder.list_names(beginning)))

    def accept_stale_copy(self, name: str) -> None:
        """Accept the stored copy of a resumed scan by setting its time to the scan's last start."""
        with self._database.write() as session:
            row = session.get(ObjectRow, name, with_for_update=True)
            scan = session.scalar(select(ScanRow).where(ScanRow.id == PurePosixPath(name).stem))
            if row is not None and scan is not None and (begun := last_write_started(scan)) is not None:
                row.created = max(row.created, begun)

    def delete(self, name: str) -> None:
        """Delete the database rows and then the objects; objects that cannot be deleted become orphans."""
        which = ObjectRow.name.startswith(name, autoescape=True) if name.endswith("/") else ObjectRow.name == name
        with self._database.write() as session:
            keys = [_key(row) for row in session.scalars(select(ObjectRow).where(which))]
            session.execute(delete(ObjectRow).where(which))
        try:
            self._bucket.delete(keys)
        except StoreUnavailable as error:
            _log.warning("%d objects are left to be swept: %s", len(keys), error)
        self._folder.delete(name)

    def is_available(self) -> bool:
        """Return whether store and database are reachable and bound to each other."""
        try:
            return self.check(self._at_once)
        except (StoreUnavailable, InvalidInput, DamagedFile, SQLAlchemyError):
            return False

    def bind(self) -> None:
        """Bind store and database by a shared identifier; raises :class:`InvalidInput` if either is bound elsewhere."""
        with self._database.write() as session:
            known, found = self._database.get_fact(session, FACT_KEY), _identity(self._bucket)
            if known is None:
                if any(key != IDENTITY for key, _, _ in self._bucket.list()):
                    raise self._foreign()
                known = found or uuid4().hex  # one that is there was made by a start that was cut off
                self._database.set_fact(session, FACT_KEY, known)
                if found is None:
                    self._bucket.create(IDENTITY, known.encode())
            elif known != found:
                raise self._foreign()

    def check(self, bucket: S3Bucket | None = None) -> bool:
        """Return whether the store is bound to the database; ``False`` before a service has bound them.

        Parameters
        ----------
        bucket
            Client of the bucket; by default one that retries for a while.

        Raises
        ------
        InvalidInput
            When the database belongs to another store.
        """
        with self._database.read() as session:
            known = self._database.get_fact(session, FACT_KEY)
        if known is not None and _identity(bucket or self._bucket) != known:
            raise self._foreign()
        return known is not None

    def is_whole(self, name: str) -> bool:
        """Download an object and return whether its SHA-256 matches its database row."""
        row = self.find_row(name)
        return row is not None and self._bucket.fetch(_key(row), Path(os.devnull)) == row.sha256

    def rows(self) -> list[ObjectRow]:
        """Return the database rows of all stored objects, by name."""
        with self._database.read() as session:
            return list(session.scalars(select(ObjectRow).order_by(ObjectRow.name)))

    def purge(self) -> None:
        """Delete all objects and the binding of store and database."""
        self._bucket.delete([key for key, _, _ in self._bucket.list() if key != IDENTITY])
        with self._database.write() as session:
            session.execute(delete(ObjectRow))
            session.execute(delete(FactRow).where(FactRow.name == FACT_KEY))
        self._bucket.delete([IDENTITY])

    def audit(self, age: timedelta = ORPHAN_GRACE) -> Contents:
        """Compare database rows with objects and return missing objects and orphans of at least the given age."""
        with self._database.read() as session:
            rows = {_key(row): row for row in session.scalars(select(ObjectRow))}
        objects, old = dict[str, int](), self._clock() - age
        orphans = list[str]()
        for key, size, modified in self._bucket.list():
            objects[key] = size
            if key not in rows and key != IDENTITY and modified <= old:
                orphans.append(key)
        missing = []
        for key, row in rows.items():
            if objects.get(key) != row.size and (now := self.find_row(row.name)) is not None and _key(now) == key:
                missing.append(row.name)  # and was not deleted meanwhile
        return Contents(len(objects), sum(objects.values()), sorted(missing), sorted(orphans))

    def collect_orphans(self, age: timedelta = ORPHAN_GRACE) -> int:
        """Delete orphaned objects under a lock that excludes commits; return their number."""
        count = 0
        orphans = self.audit(age).orphans
        for first in range(0, len(orphans), AT_A_TIME):
            keys = orphans[first : first + AT_A_TIME]
            with self._database.write() as session:
                advisory_xact_lock(session, SWEEP_LOCK)
                names = {key.rpartition("/")[0] for key in keys}
                known = {_key(row) for row in session.scalars(select(ObjectRow).where(ObjectRow.name.in_(names)))}
                self._bucket.delete(gone := [key for key in keys if key not in known])
            count += len(gone)
        return count

    def find_row(self, name: str) -> ObjectRow | None:
        """Return the database row of a stored object by name; ``None`` if there is none."""
        with self._database.read() as session:
            return session.get(ObjectRow, name)

    def _row(self, name: str) -> ObjectRow | None:
        """Return an object's current database row; ``None`` if there is none or the scan was resumed since."""
        row = self.find_row(name)
        if row is None or not name.startswith("scans/"):
            return row
        if (own := self._folder.stat(name)) is not None:
            return row if own.modified <= row.created.timestamp() + CLOCK_SKEW else None
        return None if self._has_moved_on(row) else row

    def _has_moved_on(self, row: ObjectRow) -> bool:
        with self._database.read() as session:
            scan = session.scalar(select(ScanRow).where(ScanRow.id == PurePosixPath(row.name).stem))
        return scan is not None and is_stale(scan, row)

    def _fetch(self, row: ObjectRow, draft: Path) -> None:
        if self._bucket.fetch(_key(row), draft) != row.sha256:
            raise DamagedFile(f"the stored object {row.name} does not match its checksum")

    def _foreign(self) -> InvalidInput:
        return InvalidInput("store", self.place, "the store of this database, or an empty one where it has none")


def arrays_of(
    settings: Settings, database: Database, clock: Clock = utc_now, patience: timedelta = TIMEOUT
) -> BlobStore:
    """Return the blob store that the settings select: S3 or the data folder."""
    if settings.store is None:
        return FolderBlobStore(DataDirectory(settings.data))
    return S3BlobStore(settings, database, clock, patience)


def _identity(bucket: S3Bucket) -> str | None:
    size = bucket.size(IDENTITY)
    return None if size is None else bucket.range(IDENTITY, 0, size).decode()


def _key(of: ObjectRow | StagedBlob) -> str:
    return f"{of.name}/{of.sha256}"


def _copy_of(of: ObjectRow | StagedBlob) -> str:
    """Return the file name of a cached copy: SHA-256 and the file name extension."""
    return f"{of.sha256}{PurePosixPath(of.name).suffix}"
