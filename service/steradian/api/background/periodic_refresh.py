"""Periodic refresh of in-memory copies (keys, sessions, nodes) used while the database is unavailable."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

EVERY = 1.0
"""Seconds between two looks at the database."""
_log = logging.getLogger(__name__)


class PeriodicRefresher:
    """Periodic refresher: calls functions once a second in a daemon thread.

    Parameters
    ----------
    looks
        Functions that each query the database and cache the result.
    """

    def __init__(self, *looks: Callable[[], None]) -> None:
        self._looks, self._over = looks, threading.Event()
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
        while not self._over.is_set():
            for look in self._looks:
                try:
                    look()
                except Exception as error:
                    _log.warning("keys or nodes cannot be read from the database: %s", error)
            self._over.wait(EVERY)
