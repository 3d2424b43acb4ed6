"""Requests to clear a scanner's latched fault, sent through files from the API to the acquisition process.

DATA/emergency-stop/clear     the last request: its number, when, whose
DATA/emergency-stop/cleared   what came of it
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Lock
from typing import Final

from ulid import ULID

from steradian.storage.data_dir.shared_block import open_block, read_block, write_block

WITHIN: Final = 10.0
"""Seconds after which a request is not carried out any more: whoever made it has been told that nothing came of it."""

CLEARED_WITHIN: Final = 4.5
"""Seconds that clearing itself takes at most."""


@dataclass(frozen=True)
class ClearRequest:
    """Request to clear a scanner's latched fault.

    Attributes
    ----------
    number
        Unique number of the request (a ULID).
    who
        Principal that made the request.
    moment
        Time on the machine's monotonic clock, in s.
    """

    number: str
    who: str
    moment: float

    @property
    def has_time(self) -> bool:
        """Whether enough time is left to execute and answer the request before it expires."""
        return 0 <= time.monotonic() - self.moment < WITHIN - CLEARED_WITHIN

    @property
    def is_current(self) -> bool:
        """Whether the request has not expired."""
        return 0 <= time.monotonic() - self.moment < WITHIN


@dataclass(frozen=True)
class ClearAnswer:
    """Result of a request to clear a fault: the cleared fault or an error.

    Attributes
    ----------
    number
        Number of the request.
    fault
        Name of the fault that was cleared; empty: none was latched, or it was not cleared.
    code, message
        Code and text of the error if the fault was not cleared; else empty.
    """

    number: str
    fault: str = ""
    code: str = ""
    message: str = ""


class ClearFaultRequest:
    """Channel for fault-clearing requests and their results: two shared files in the data folder.

    Parameters
    ----------
    folder
        Folder of the two files, which are created if missing and stay open.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._asked, self._answered = open_block(folder / "clear"), open_block(folder / "cleared")
        self._lock = Lock()

    def ask(self, who: str) -> ClearRequest:
        """Write a request to clear the fault and return it."""
        request = ClearRequest(str(ULID()), who[:200], time.monotonic())
        with self._lock:
            write_block(self._asked, asdict(request))
        return request

    def asked(self) -> ClearRequest | None:
        """Return the last request if it has not expired, else ``None``."""
        try:
            found = read_block(self._asked, "clear")
        except ValueError:
            return None
        request = None if found is None else ClearRequest(**found)
        return request if request is not None and request.is_current else None

    def answer(self, answer: ClearAnswer) -> None:
        """Write the result of a request."""
        with self._lock:
            write_block(self._answered, asdict(answer))

    def answered(self, number: str) -> ClearAnswer | None:
        """Return the result of a request, or None if there is none yet."""
        try:
            found = read_block(self._answered, "cleared")
        except ValueError:
            return None
        return ClearAnswer(**found) if found is not None and found["number"] == number else None
