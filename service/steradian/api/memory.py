"""What is kept in mind for the time when the database does not answer."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

EVERY = 1.0
"""Seconds between two looks at the database."""
_log = logging.getLogger(__name__)


class Memory:
    """Looks again and again, in a thread.

    Parameters
    ----------
    looks
        Each looks at the database and remembers what it has seen.
    """

    def __init__(self, *looks: Callable[[], None]) -> None:
        self._looks, self._over = looks, threading.Event()
        self._thread = threading.Thread(target=self._run, name="memory", daemon=True)

    def open(self) -> None:
        """Begin."""
        self._thread.start()

    def close(self) -> None:
        """Look no more; a look that is under way is waited for a moment, or it opens connections that nobody closes."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join(EVERY)

    def _run(self) -> None:
        while not self._over.is_set():
            for look in self._looks:
                try:
                    look()
                except Exception as error:
                    _log.warning("keys or nodes cannot be looked at in the database: %s", error)
            self._over.wait(EVERY)
