"""Recorder of the scanner's status in the database, for other nodes and the event log."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from sqlalchemy.exc import SQLAlchemyError

from steradian.storage.data_dir.scanner_status import LOOK_INTERVAL_ELSEWHERE, ScannerStatus, wording

NOTE: Final = 0.2
"""Seconds between two looks at what the database should know."""
AGAIN: Final = 1.0
"""Seconds until a database that does not answer is tried again."""
_log = logging.getLogger(__name__)


class ScannerStatusRecorder:
    """Recorder that writes changes of the scanner's status to the database; retries after database errors.

    Parameters
    ----------
    status
        Callback that returns the current status.
    note
        Callback that writes a status; may raise SQLAlchemyError.
    shared
        Whether the status is also written every few seconds without a change, so that other nodes know its age.
    """

    def __init__(
        self, status: Callable[[], ScannerStatus], note: Callable[[ScannerStatus], object], *, shared: bool
    ) -> None:
        self._status, self._note, self._shared = status, note, shared
        self._known: ScannerStatus | None = None
        self._noted = 0.0
        self._answers = True

    def run(self, over: threading.Event) -> None:
        """Write status changes to the database until the event ``over`` is set."""
        while not over.wait(NOTE):
            try:
                self._step()
            except SQLAlchemyError as error:
                if self._answers:
                    _log.warning("the scanner's state cannot be noted in the database: %s", error)
                self._answers = False
                over.wait(AGAIN)
            except Exception:  # nobody else would notice that this thread has ended
                _log.exception("the scanner's state cannot be noted")
                over.wait(AGAIN)

    def _step(self) -> None:
        now = self._status().as_of_now()
        is_due = self._shared and time.monotonic() - self._noted >= LOOK_INTERVAL_ELSEWHERE
        plain = replace(now, heard=None, error=wording(now.error))
        if plain == self._known and not is_due:
            return
        self._note(now)
        self._known, self._noted, self._answers = plain, time.monotonic(), True
