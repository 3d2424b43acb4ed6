"""Periodic refresh of in-memory copies (keys, sessions, nodes) used while the database is unavailable."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from steradian.storage.db.change_detector import MAX_IDLE_INTERVAL, ChangeDetector
from steradian.storage.db.database import Database

EVERY = 1.0
"""Seconds between two looks at the database."""
_log = logging.getLogger(__name__)


class PeriodicRefresher:
    """Periodic refresher: calls functions in a daemon thread, at most a second after the database has changed.

    Parameters
    ----------
    database
        The database that the functions query.
    looks
        Functions that each query the database and cache the result.
    """

    def __init__(self, database: Database, *looks: Callable[[], None]) -> None:
        self._database, self._looks, self._over = database, looks, threading.Event()
        self._thread = threading.Thread(target=self._run, name="memory", daemon=True)

    def open(self) -> None:
        """Start the refresh thread."""
        self._thread.start()

    def close(self) -> None:
        """Stop the refresh thread; wait briefly for a query in progress, so that its connection is closed."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join(EVERY)

    def _run(self) -> None:
        changes = ChangeDetector(self._database, MAX_IDLE_INTERVAL)
        while not self._over.is_set():
            for look in self._looks if changes.has_changed() else ():
                try:
                    look()
                except Exception as error:
                    changes.reset()
                    _log.warning("keys or nodes cannot be read from the database: %s", error)
            self._over.wait(EVERY)
