"""Cheap detection of writes to a SQLite database since the last check."""

from __future__ import annotations

import sqlite3
import time
from pathlib import Path
from typing import Final

from steradian.storage.data_dir.sqlite_urls import file_uri
from steradian.storage.db.database import Database

MAX_INTERVAL: Final = 1.0
"""Seconds after which one looks even if nothing was written: what was tried in vain is tried again."""

MAX_IDLE_INTERVAL: Final = 30.0
"""The same for work that depends on the database alone."""


class ChangeDetector:
    """Detector of database changes, which saves a polling reader needless queries; not thread-safe.

    Parameters
    ----------
    database
        Database; changes of a server database cannot be detected, so every check returns true.
    at_least
        Seconds after which a check returns true in any case.
    """

    def __init__(self, database: Database, at_least: float = MAX_INTERVAL) -> None:
        self._path = database.name if database.is_file else None
        self._at_least, self._due = at_least, 0.0
        self._connection: sqlite3.Connection | None = None
        self._version: int | None = None

    def has_changed(self) -> bool:
        """Return whether a transaction may have been committed since the previous call."""
        now, version = time.monotonic(), self._read()
        if version is not None and version == self._version and now < self._due:
            return False
        self._version, self._due = version, now + self._at_least
        return True

    def reset(self) -> None:
        """Make the next check return true."""
        self._due = 0.0

    def _read(self) -> int | None:
        """Return SQLite's ``data_version``, which changes with each commit; ``None`` for a server database."""
        if self._path is None:
            return None
        try:
            if self._connection is None:
                url = file_uri(Path(self._path))
                self._connection = sqlite3.connect(url, uri=True, check_same_thread=False)  # whoever drops it closes it
            return int(self._connection.execute("PRAGMA data_version").fetchone()[0])
        except sqlite3.Error:
            self.close()
            return None

    def close(self) -> None:
        """Close the detector's own connection; the next check opens a new one."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def __del__(self) -> None:
        self.close()
