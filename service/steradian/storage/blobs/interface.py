"""Interface of the blob store: scans, uploads and job results by name.

What is kept has a name, the path that it has in a data folder: ``scans/<id>.h5``, ``jobs/<id>/<file>``,
``uploads/<id>``. It never changes. A scan under way, the folder of a job that runs and an upload that is coming are not
kept yet: they are local files of whoever writes them, given to :meth:`BlobStore.put` when they are whole.
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
    """Name of the A-lines of a scan."""
    return f"scans/{scan_id}.h5"


def upload_name(upload_id: str) -> str:
    """Name of a file that came over HTTP."""
    return f"uploads/{upload_id}"


def result_name(job_id: str, file: str = "") -> str:
    """Name of a job's result file; without ``name``, the common prefix of all of them."""
    return f"jobs/{job_id}/{file}"


@dataclass(frozen=True)
class BlobInfo:
    """Size in bytes and modification time (s since 1970) of a blob."""

    size: int
    modified: float


@dataclass(frozen=True)
class StagedBlob:
    """Staged blob that :meth:`BlobStore.commit` makes visible under its name.

    ``sha256`` is of their content, empty where files are known by their place.
    """

    name: str
    size: int
    created: datetime
    sha256: str = ""

    def as_json(self) -> dict[str, Any]:
        """Write it for another process; :meth:`of_json` reads it."""
        return asdict(self) | {"created": self.created.isoformat()}

    @classmethod
    def of_json(cls, said: dict[str, Any]) -> Self:
        """Parse the output of :meth:`as_json`."""
        return cls(**said | {"created": datetime.fromisoformat(said["created"])})


class BlobStore(Protocol):
    """Store of immutable blobs, safe for concurrent threads and processes."""

    def open(self, name: str) -> Path:
        """Return a local file with the whole of it, only to be read; raises :class:`NotFound`."""
        ...

    def put(self, name: str, file: Path) -> StagedBlob:
        """Take a whole file over; it is not where it was any more.

        Nobody sees a part of it, also when this process is killed.
        """
        ...

    def commit(self, session: Session, *stored: StagedBlob) -> None:
        """Commit a staged blob under its name when the transaction commits."""
        ...

    def put_and_commit(self, name: str, file: Path) -> None:
        """Put and announce in one go."""
        ...

    def stat(self, name: str) -> BlobInfo | None:
        """Return size and time of a blob; ``None`` if it does not exist."""
        ...

    def range(self, name: str, first: int, count: int) -> bytes:
        """Read some bytes, fewer at the end; raises :class:`NotFound`."""
        ...

    def url(self, name: str, seconds: float) -> str | None:
        """Return a temporary public URL of a blob; ``None`` if the store has none."""
        ...

    def list_names(self, beginning: str) -> Iterator[str]:
        """Name all whose names begin so, sorted."""
        ...

    def accept_stale_copy(self, name: str) -> None:
        """Accept the stored copy of a scan although the scan was resumed since.

        Newer A-lines are lost with their host.
        """
        ...

    def delete(self, name: str) -> None:
        """Forget one thing, or all below a name that ends in a slash; nothing happens when there is none."""
        ...

    def is_available(self) -> bool:
        """Whether something can be kept now."""
        ...


class FolderBlobStore:
    """Blob store on the local data folder.

    Parameters
    ----------
    data
        The data folder.
    """

    def __init__(self, data: DataDirectory) -> None:
        self._root = data.root.absolute()

    def open(self, name: str) -> Path:
        """Return the file itself."""
        path = self._root / name
        if not path.is_file():
            raise NotFound("file", name)
        return path

    def put(self, name: str, file: Path) -> StagedBlob:
        """Give the file its place, where it survives a power cut if its bytes do."""
        path = self._root / name
        if file != path:
            os.replace(file, path)
            sync_folder(path.parent)
        found = path.stat()
        return StagedBlob(name, found.st_size, datetime.fromtimestamp(found.st_mtime, UTC))

    def commit(self, session: Session, *stored: StagedBlob) -> None:
        """Do nothing: a file is known by its place."""

    def put_and_commit(self, name: str, file: Path) -> None:
        """Put it."""
        self.put(name, file)

    def stat(self, name: str) -> BlobInfo | None:
        """Look at the file."""
        path = self._root / name
        try:
            found = path.stat()
        except OSError:
            return None
        return BlobInfo(found.st_size, found.st_mtime) if path.is_file() else None

    def range(self, name: str, first: int, count: int) -> bytes:
        """Read a part of the file."""
        with self.open(name).open("rb") as file:
            file.seek(first)
            return file.read(count)

    def url(self, name: str, seconds: float) -> str | None:
        """Return nothing: only the service shows files."""
        return None

    def list_names(self, beginning: str) -> Iterator[str]:
        """Look through the folder; drafts are not there yet."""
        folder, _, start = beginning.rpartition("/")
        for path in sorted((self._root / folder).glob(f"{start}*")):
            if path.is_file() and DRAFT_SUFFIX not in path.name:
                yield path.relative_to(self._root).as_posix()

    def accept_stale_copy(self, name: str) -> None:
        """Do nothing: the file is all that there is."""

    def delete(self, name: str) -> None:
        """Remove the file, or the folder with all that is in it."""
        path = self._root / name
        if name.endswith("/") and path.exists():
            shutil.rmtree(path)
        elif not name.endswith("/"):
            path.unlink(missing_ok=True)

    def is_available(self) -> bool:
        """Whether the folder can be written to."""
        return os.access(self._root / "scans", os.W_OK)
