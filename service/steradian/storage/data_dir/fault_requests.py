"""Requests to clear a scanner's latched fault, from the API to the acquisition process of the same node.

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
    """One request.

    Attributes
    ----------
    number
        Of this request alone.
    who
        The person or program that asks.
    moment
        When, in s of the machine's monotonic clock.
    """

    number: str
    who: str
    moment: float

    @property
    def has_time(self) -> bool:
        """Whether the request can still be executed and answered in time."""
        return 0 <= time.monotonic() - self.moment < WITHIN - CLEARED_WITHIN

    @property
    def is_current(self) -> bool:
        """Whether it may still be carried out."""
        return 0 <= time.monotonic() - self.moment < WITHIN


@dataclass(frozen=True)
class ClearAnswer:
    """Outcome of a request.

    Attributes
    ----------
    number
        Of the request.
    fault
        Name of the fault that was cleared; empty: none was latched, or it was not cleared.
    code, message
        Why it was not cleared, as an error's code and sentence; empty: it was.
    """

    number: str
    fault: str = ""
    code: str = ""
    message: str = ""


class Clearing:
    """The two blocks of one data folder.

    Parameters
    ----------
    folder
        Where they are; they are made if they are missing, and kept open.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._asked, self._answered = open_block(folder / "clear"), open_block(folder / "cleared")
        self._lock = Lock()

    def ask(self, who: str) -> ClearRequest:
        """Make a request."""
        request = ClearRequest(str(ULID()), who[:200], time.monotonic())
        with self._lock:
            write_block(self._asked, asdict(request))
        return request

    def asked(self) -> ClearRequest | None:
        """Return the last request, if it may still be carried out."""
        try:
            found = read_block(self._asked, "clear")
        except ValueError:
            return None
        request = None if found is None else ClearRequest(**found)
        return request if request is not None and request.is_current else None

    def answer(self, answer: ClearAnswer) -> None:
        """Write the outcome of a request."""
        with self._lock:
            write_block(self._answered, asdict(answer))

    def answered(self, number: str) -> ClearAnswer | None:
        """Return the outcome of a request, or None if it is unanswered."""
        try:
            found = read_block(self._answered, "cleared")
        except ValueError:
            return None
        return ClearAnswer(**found) if found is not None and found["number"] == number else None
