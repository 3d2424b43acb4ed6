"""Interface between a scan session and its owner: commands in, phases and progress out."""

from __future__ import annotations

import time
from contextlib import AbstractContextManager, nullcontext
from enum import StrEnum

import fabry_perot
from steradian.core.progress import CancelCheck, Progress


class Command(StrEnum):
    """Command to a running session."""

    RUN = "run"
    PAUSE = "pause"
    """Stop firing, keep the scanner and go on when told to."""
    STOP = "stop"
    """Enough: keep what was fired, and end in good order."""
    SHUTDOWN = "leave"
    """Laser off at once, then keep what was fired before."""
    ABORT = "abort"
    """Laser off at once."""


TERMINAL_COMMANDS = frozenset({Command.STOP, Command.SHUTDOWN, Command.ABORT})
"""Wishes that end a session."""


class SessionPhase(StrEnum):
    """Phase of a session."""

    ARMING = "arming"
    RUNNING = "running"
    RECOVERING = "recovering"
    """Line or device failed; the driver is taking the scan up again."""
    RESCUING = "rescuing"
    """What was fired before this session is fetched from the scanner; the file is written to from now on."""
    PAUSING = "pausing"
    PAUSED = "paused"
    STOPPING = "stopping"
    ABORTING = "aborting"
    COMPLETING = "completing"


class SessionOutcome(StrEnum):
    """Outcome of a session."""

    COMPLETE = "complete"
    STOPPED = "stopped"
    ABORTED = "aborted"


class SessionControl:
    """A session's view of its starter; this one runs to the end unless ``cancelled`` says otherwise.

    Parameters
    ----------
    progress
        Told how many A-lines are stored.
    cancelled
        Makes the session leave: laser off, what was fired is kept.
    """

    def __init__(self, progress: Progress | None = None, cancelled: CancelCheck | None = None) -> None:
        self._progress, self._cancelled = progress, cancelled

    def monitor(self, scanner: fabry_perot.Scanner) -> AbstractContextManager[None]:
        """Monitor a connected scanner until the block ends; the base class leaves that to the session."""
        return nullcontext()

    def may_fire(self, allowed: bool) -> None:
        """Handle, before it happens, that the scanner may fire from now on, or afterwards that it no longer may."""

    def command(self) -> Command:
        """Return the current command; called about twenty times a second."""
        return Command.SHUTDOWN if self._cancelled is not None and self._cancelled() else Command.RUN

    def on_phase(self, phase: SessionPhase) -> None:
        """Learn that the session is now at ``phase``."""

    def on_laser_off(self) -> None:
        """Learn that the scanner has confirmed that its laser is off, after :attr:`Command.SHUTDOWN`."""

    def on_storage_blocked(self, why: str | None) -> None:
        """Learn that the session cannot store A-lines at present, and why; ``None``: it can again."""

    def progress(self, done: int, total: int) -> None:
        """Learn how many A-lines are stored."""
        if self._progress is not None:
            self._progress("A-lines", done, total)

    def wait(self, seconds: float) -> None:
        """Wait until the session polls again."""
        time.sleep(seconds)
