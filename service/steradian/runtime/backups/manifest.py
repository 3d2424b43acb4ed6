"""Manifest of a backup: its files with checksums, and their verification."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final, Self

from steradian._version import __version__
from steradian.core.atomic_files import write_durably
from steradian.core.exceptions import Cancelled, DamagedFile
from steradian.core.progress import CancelCheck, Progress
from steradian.storage.data_dir.layout import PRIVATE_MODE

FORMAT: Final = "steradian backup"
VERSION: Final = 1
NAME: Final = "manifest.json"
DATABASE: Final = "database.sqlite"
FOLDERS: Final = frozenset({"scans", "uploads", "jobs", "emergency-stop"})
"""Of the data folder, those whose files are copied."""
CHANGED: Final = "is not as it was when the backup was made"
PIECE: Final = 1 << 20
"""Bytes that are copied at a time."""


@dataclass(frozen=True)
class Entry:
    """Size in bytes and SHA-256 of one file."""

    size: int
    sha256: str


@dataclass(frozen=True)
class Manifest:
    """Manifest of a backup: files with checksums, schema revision and counts.

    Attributes
    ----------
    made
        Time of the database snapshot, ISO 8601 in UTC.
    revision
        Revision of the database schema.
    scans, jobs
        Number of rows of each.
    damaged
        Known damage of the service's scan files, by scan.
    files
        Entries by path in the folder, with slashes.
    """

    made: str
    revision: str
    scans: int
    jobs: int
    damaged: dict[str, str]
    files: dict[str, Entry]

    @property
    def size(self) -> int:
        """Total size in bytes of all files."""
        return sum(entry.size for entry in self.files.values())

    def write(self, folder: Path) -> None:
        """Write the manifest file, which completes the backup."""
        document = {"format": FORMAT, "version": VERSION, "steradian": __version__, **asdict(self)}
        write_durably(folder / NAME, json.dumps(document, indent=1, sort_keys=True))

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read and validate the manifest file of a backup.

        Raises
        ------
        DamagedFile
            When the folder is not a backup, or the backup is incomplete or of a newer version.
        """
        try:
            document = json.loads((folder / NAME).read_text())
            if document["format"] != FORMAT or document["version"] != VERSION:
                kind = f"{document['format']} {document['version']}, made by Steradian {document['steradian']}"
                raise DamagedFile(f"{folder} is {kind}; this program reads {FORMAT} {VERSION}")
            files = {path: Entry(**entry) for path, entry in document["files"].items()}
            fields = {name: document[name] for name in ("made", "revision", "scans", "jobs", "damaged")}
        except (FileNotFoundError, NotADirectoryError):
            raise DamagedFile(f"{folder} is not a backup, or not a finished one: it has no {NAME}") from None
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise DamagedFile(f"{folder / NAME} cannot be read as a backup's: {error!r}") from error
        if strange := [path for path in files if not _is_ours(path)]:
            raise DamagedFile(f"{folder / NAME} names {strange[0]!r}, which no backup holds")
        if DATABASE not in files:
            raise DamagedFile(f"{folder / NAME} names no {DATABASE}, which every backup holds")
        return cls(**fields, files=files)

    def verify(self, folder: Path) -> Iterator[tuple[str, str]]:
        """Verify a backup's files against their checksums; yields path and fault of each damaged or missing file."""
        for path, entry in self.files.items():
            if not (folder / path).is_file():
                yield path, "is missing"
            elif hash_file(folder / path) != entry:
                yield path, CHANGED


def _is_ours(path: str) -> bool:
    """Return whether a path is allowed in a backup; rejects paths outside of its folder."""
    kind, *within = path.split("/")
    if not path.isprintable() or {"", ".", ".."} & {kind, *within}:
        return False
    return kind in FOLDERS if within else path in {DATABASE, "identity"}


def copy_file(source: Path, target: Path, tick: Callable[[int], object] = bool) -> Entry:
    """Copy a file, sync it to disk and return size and checksum; ``tick`` is called with each chunk's size."""
    digest, size = hashlib.sha256(), 0
    target.parent.mkdir(mode=PRIVATE_MODE, parents=True, exist_ok=True)
    with source.open("rb") as read, target.open("wb") as write:
        while piece := read.read(PIECE):
            tick(len(piece))
            digest.update(piece)
            size += len(piece)
            write.write(piece)
        write.flush()
        os.fsync(write.fileno())
    return Entry(size, digest.hexdigest())


class CopyProgress:
    """Progress reporter of a copy, in bytes, with cancellation.

    Parameters
    ----------
    total
        Bytes.
    """

    def __init__(self, total: int, progress: Progress | None, cancelled: CancelCheck | None) -> None:
        self._total, self._progress, self._cancelled = total, progress, cancelled
        self._done = 0
        self(0)

    def __call__(self, count: int) -> None:
        """Add copied bytes to the progress; raises :class:`Cancelled`."""
        if self._cancelled is not None and self._cancelled():
            raise Cancelled("stopped; nothing of it is kept")
        self._done += count
        if self._progress is not None:
            self._progress("copying, MB", min(self._done, self._total) // 1_000_000, self._total // 1_000_000)


def hash_file(path: Path) -> Entry:
    """Return size and checksum of a file."""
    with path.open("rb") as file:
        return Entry(os.fstat(file.fileno()).st_size, hashlib.file_digest(file, "sha256").hexdigest())


def regular_files(folder: Path) -> Iterator[Path]:
    """Yield the regular files below a folder, without symbolic links."""
    for root, _, names in os.walk(folder):
        for path in (Path(root, name) for name in names):
            if path.is_file() and not path.is_symlink():
                yield path
