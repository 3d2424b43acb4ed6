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
    """Manifest of a backup.

    Attributes
    ----------
    made
        When its rows were read, ISO 8601 in UTC.
    revision
        Version of the tables.
    scans, jobs
        How many rows there are of each.
    damaged
        What the service's own files lack already, by the scan.
    files
        By their paths in the folder, with slashes.
    """

    made: str
    revision: str
    scans: int
    jobs: int
    damaged: dict[str, str]
    files: dict[str, Entry]

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(entry.size for entry in self.files.values())

    def write(self, folder: Path) -> None:
        """Make a backup of a folder; nothing is written to it afterwards."""
        document = {"format": FORMAT, "version": VERSION, "steradian": __version__, **asdict(self)}
        write_durably(folder / NAME, json.dumps(document, indent=1, sort_keys=True))

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read the manifest of a backup.

        Raises
        ------
        DamagedFile
            When the folder is no backup, or one that was not finished or is of a newer version.
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
        """Verify a backup against its manifest; yields path and fault of each damaged or missing file."""
        for path, entry in self.files.items():
            if not (folder / path).is_file():
                yield path, "is missing"
            elif hash_file(folder / path) != entry:
                yield path, CHANGED


def _is_ours(path: str) -> bool:
    """Whether a path is one that a backup may contain, and lies inside of it."""
    kind, *within = path.split("/")
    if not path.isprintable() or {"", ".", ".."} & {kind, *within}:
        return False
    return kind in FOLDERS if within else path in {DATABASE, "identity"}


def copy_file(source: Path, target: Path, tick: Callable[[int], object] = bool) -> Entry:
    """Copy a file durably and return size and checksum; ``tick`` is called with each chunk and may raise."""
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
    """Progress of a copy in bytes, with cancellation.

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
        """Count bytes that are about to be copied; raises :class:`Cancelled`."""
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
    """Name the files below a folder, links left out."""
    for root, _, names in os.walk(folder):
        for path in (Path(root, name) for name in names):
            if path.is_file() and not path.is_symlink():
                yield path
