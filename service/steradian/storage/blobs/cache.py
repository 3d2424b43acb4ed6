"""Content-addressed cache of remote objects on local disk, evicted least recently used."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

import filelock

from steradian.core.atomic_files import DRAFT_SUFFIX

MAX_PINNED: Final = 16
"""Files that a process holds: those that it has asked for last."""
ABANDONED_AFTER: Final = 3600.0
"""Seconds after which a draft that nobody writes to is removed."""
LOCKS: Final = "locks"


class ContentCache:
    """LRU cache of files in a folder, safe for concurrent threads and processes.

    Parameters
    ----------
    folder
        Folder of the cached files, created if missing.
    limit
        Maximum size in bytes. Pinned files, which a process has just used, may exceed the limit.
    """

    def __init__(self, folder: Path, limit: int) -> None:
        self._folder, self._limit = folder, limit
        self._held: OrderedDict[Path, int] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, name: str, size: int, modified: float, fetch: Callable[[Path], None]) -> Path:
        """Return the path of a cached file, calling ``fetch`` on a miss; recently used files are pinned.

        Parameters
        ----------
        name
            File name, derived from the content.
        size
            Size in bytes; older files are evicted to make room.
        modified
            Modification time to set (s since 1970), the same on every host.
        fetch
            Callback that writes the file to a path; its exceptions are propagated, and nothing is cached.
        """
        path = self._folder / name
        while not self._hold(path):
            with self._alone(name):
                if not path.is_file():
                    self._make_room(size)
                    self._add(path, modified, fetch)
        return path

    def adopt(self, name: str, file: Path, modified: float) -> None:
        """Move an existing file into the cache under the name derived from its content."""
        self._make_room(file.stat().st_size)
        with self._alone(name):
            os.utime(file, (time.time(), modified))
            os.replace(file, self._folder / name)

    def peek(self, name: str) -> Path | None:
        """Return the path of a cached file, or ``None`` if it is not cached."""
        path = self._folder / name
        return path if self._hold(path) else None

    def _add(self, path: Path, modified: float, fetch: Callable[[Path], None]) -> None:
        draft = path.with_name(f"{path.name}.{os.getpid()}{DRAFT_SUFFIX}")
        try:
            fetch(draft)
            os.utime(draft, (time.time(), modified))
            os.replace(draft, path)
        finally:
            draft.unlink(missing_ok=True)

    def _alone(self, name: str) -> filelock.BaseFileLock:
        """Return the file lock that prevents concurrent fetches of a name; names share a fixed set of lock files."""
        (self._folder / LOCKS).mkdir(mode=0o700, parents=True, exist_ok=True)
        return filelock.FileLock(self._folder / LOCKS / name[:3])

    def _hold(self, path: Path) -> bool:
        """Pin a cached file against eviction and update its access time; return ``False`` if it is not cached."""
        with self._lock:
            try:
                if path not in self._held:
                    self._held[path] = _held(path)
                os.utime(path, (time.time(), path.stat().st_mtime))
            except FileNotFoundError:
                if (handle := self._held.pop(path, None)) is not None:
                    os.close(handle)
                return False
            self._held.move_to_end(path)
            while len(self._held) > MAX_PINNED:
                os.close(self._held.popitem(last=False)[1])
        return True

    def _make_room(self, size: int) -> None:
        """Evict the least recently used files until ``size`` more bytes fit within the limit."""
        found, now = [], time.time()
        self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        for entry in os.scandir(self._folder):
            with suppress(FileNotFoundError):
                about = entry.stat()
                if entry.name.endswith(DRAFT_SUFFIX) and now - about.st_mtime > ABANDONED_AFTER:
                    os.unlink(entry)
                elif entry.is_file():
                    found.append((about.st_atime, about.st_size, Path(entry)))
        total = size + sum(each for _, each, _ in found)
        for _, each, path in sorted(found):
            if total <= self._limit:
                return
            if not path.name.endswith(DRAFT_SUFFIX) and _remove(path):
                total -= each


def _held(path: Path) -> int:
    """Open a file with a shared lock, which prevents its eviction, and return the descriptor."""
    handle = os.open(path, os.O_RDONLY)
    if sys.platform != "win32":  # there what is open cannot be removed
        import fcntl

        fcntl.flock(handle, fcntl.LOCK_SH)
    try:
        if not os.path.samestat(os.fstat(handle), path.stat()):
            raise FileNotFoundError(path)
    except FileNotFoundError:  # removed just before it was locked
        os.close(handle)
        raise
    return handle


def _remove(path: Path) -> bool:
    """Delete a file unless a process holds a lock on the file; return whether no file is left."""
    try:
        handle = os.open(path, os.O_RDONLY)
        try:
            if sys.platform != "win32":
                import fcntl

                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink()
        finally:
            os.close(handle)
    except FileNotFoundError:
        return True
    except OSError:
        return False
    return True
