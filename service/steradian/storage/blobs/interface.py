"""Interface of the blob store (scans, uploads, job results, by name) and its local implementation.

A blob's name is its path in a data folder: ``scans/<id>.h5``, ``jobs/<id>/<file>``, ``uploads/<id>``. Blobs never
change. A running scan, the folder of a running job and an incomplete upload are not blobs yet: they are local files of
the process that writes them, passed to :meth:`BlobStore.put` when complete.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, Self

from steradian.core.atomic_files import DRAFT_SUFFIX, sync_folder
from steradian.core.exceptions import NotFound
from steradian.storage.data_dir.layout import DataDirectory

if TYPE_CHECKING:
    from sqlalchemy.orm import Session


def scan_name(scan_id: str) -> str:
    """Return the blob name of a scan's file."""
    return f"scans/{scan_id}.h5"


def upload_name(upload_id: str) -> str:
    """Return the blob name of an uploaded file."""
    return f"uploads/{upload_id}"


def result_name(job_id: str, file: str = "") -> str:
    """Return the blob name of a job's result file; without ``file``, the prefix of all of the job's results."""
    return f"jobs/{job_id}/{file}"


@dataclass(frozen=True)
class BlobInfo:
    """Size in bytes and modification time (s since 1970) of a blob."""

    size: int
    modified: float


@dataclass(frozen=True)
class StagedBlob:
    """Record of an uploaded blob that becomes visible with :meth:`BlobStore.commit`.

    ``sha256`` is the hash of the content, empty in the data folder, where files are identified by their path.
    """

    name: str
    size: int
    created: datetime
    sha256: str = ""

    def as_json(self) -> dict[str, Any]:
        """Return the record as JSON-compatible values, for another process."""
        return asdict(self) | {"created": self.created.isoformat()}

    @classmethod
    def of_json(cls, said: dict[str, Any]) -> Self:
        """Parse a record from the output of :meth:`as_json`."""
        return cls(**said | {"created": datetime.fromisoformat(said["created"])})


class BlobStore(Protocol):
    """Interface of a store of immutable blobs, safe for concurrent threads and processes."""

    def open(self, name: str) -> Path:
        """Return the path of a local, read-only file with the blob's content; raises :class:`NotFound`."""
        ...

    def put(self, name: str, file: Path) -> StagedBlob:
        """Move a file into the store as an uncommitted blob; the source path no longer exists afterwards.

        Readers never see a partial blob, also when this process is killed.
        """
        ...

    def commit(self, session: Session, *stored: StagedBlob) -> None:
        """Make staged blobs visible under their names when the transaction commits."""
        ...

    def put_and_commit(self, name: str, file: Path) -> None:
        """Store a file and make the blob visible in one step."""
        ...

    def stat(self, name: str) -> BlobInfo | None:
        """Return size and time of a blob; ``None`` if it does not exist."""
        ...

    def range(self, name: str, first: int, count: int) -> bytes:
        """Return at most ``count`` bytes of a blob from offset ``first``; raises :class:`NotFound`."""
        ...

    def url(self, name: str, seconds: float) -> str | None:
        """Return a temporary public URL of a blob; ``None`` if the store has none."""
        ...

    def list_names(self, beginning: str) -> Iterator[str]:
        """Yield the names of all blobs with a prefix, sorted."""
        ...

    def accept_stale_copy(self, name: str) -> None:
        """Accept the stored copy of a scan although the scan was resumed since.

        Newer A-lines are lost with their host.
        """
        ...

    def delete(self, name: str) -> None:
        """Delete a blob, or all blobs below a name that ends with a slash; missing blobs are ignored."""
        ...

    def is_available(self) -> bool:
        """Return whether the store accepts writes now."""
        ...


class FolderBlobStore:
    """Blob store in the local data folder.

    Parameters
    ----------
    data
        The data folder.
    """

    def __init__(self, data: DataDirectory) -> None:
        self._root = data.root.absolute()

    def open(self, name: str) -> Path:
        """Return the path of a blob's file in the data folder."""
        path = self._root / name
        if not path.is_file():
            raise NotFound("file", name)
        return path

    def put(self, name: str, file: Path) -> StagedBlob:
        """Move a file to its place in the data folder and sync the folder, without syncing the content."""
        path = self._root / name
        if file != path:
            os.replace(file, path)
            sync_folder(path.parent)
        found = path.stat()
        return StagedBlob(name, found.st_size, datetime.fromtimestamp(found.st_mtime, UTC))

    def commit(self, session: Session, *stored: StagedBlob) -> None:
        """Do nothing, because a file in the data folder is visible at once."""

    def put_and_commit(self, name: str, file: Path) -> None:
        """Move a file to its place in the data folder, where it is visible at once."""
        self.put(name, file)

    def stat(self, name: str) -> BlobInfo | None:
        """Return size and modification time of a blob's file; ``None`` if it does not exist."""
        path = self._root / name
        try:
            found = path.stat()
        except OSError:
            return None
        return BlobInfo(found.st_size, found.st_mtime) if path.is_file() else None

    def range(self, name: str, first: int, count: int) -> bytes:
        """Read ``count`` bytes of a blob's file from offset ``first``."""
        with self.open(name).open("rb") as file:
            file.seek(first)
            return file.read(count)

    def url(self, name: str, seconds: float) -> str | None:
        """Return None, because local files have no public URL."""
        return None

    def list_names(self, beginning: str) -> Iterator[str]:
        """Yield the names of the files with a prefix, without temporary files."""
        folder, _, start = beginning.rpartition("/")
        for path in sorted((self._root / folder).glob(f"{start}*")):
            if path.is_file() and DRAFT_SUFFIX not in path.name:
                yield path.relative_to(self._root).as_posix()

    def accept_stale_copy(self, name: str) -> None:
        """Accept a stored copy older than the scan: no effect, because the data folder has no second copy."""

    def delete(self, name: str) -> None:
        """Delete a blob's file, or a folder with its content."""
        path = self._root / name
        if name.endswith("/") and path.exists():
            shutil.rmtree(path)
        elif not name.endswith("/"):
            path.unlink(missing_ok=True)

    def is_available(self) -> bool:
        """Return whether the data folder is writable."""
        return os.access(self._root / "scans", os.W_OK)
