"""Interface between a scan session and its caller: commands in, phases and progress out."""

from __future__ import annotations

import time
from contextlib import AbstractContextManager, nullcontext
from enum import StrEnum

import fabry_perot
from steradian.core.progress import CancelCheck, Progress
from steradian.plans import ScanPlan
from steradian.plans.stages import Points, Proposal, StageRecord


class Command(StrEnum):
    """Command to a running scan session: run, pause, stop, abort or shut down."""

    RUN = "run"
    PAUSE = "pause"
    """Stop firing, stay connected and resume on command."""
    STOP = "stop"
    """Stop firing, store the A-lines already fired, and end."""
    SHUTDOWN = "leave"
    """Laser off at once, then store the A-lines fired before."""
    ABORT = "abort"
    """Laser off at once."""


TERMINAL_COMMANDS = frozenset({Command.STOP, Command.SHUTDOWN, Command.ABORT})
"""Wishes that end a session."""


class SessionPhase(StrEnum):
    """Phase of a scan session, reported to its caller."""

    ARMING = "arming"
    RUNNING = "running"
    RECOVERING = "recovering"
    """Line or device failed; the driver is resuming the scan."""
    RESCUING = "rescuing"
    """A-lines fired before this session are fetched from the scanner; the file is written from now on."""
    PAUSING = "pausing"
    PAUSED = "paused"
    STOPPING = "stopping"
    ABORTING = "aborting"
    COMPLETING = "completing"
    PLANNING = "planning"
    """The laser is off; the next stage is computed."""
    DECIDING = "deciding"
    """The laser is off until a person chooses points of interest."""


class SessionOutcome(StrEnum):
    """Outcome of a scan session."""

    COMPLETE = "complete"
    STOPPED = "stopped"
    ENOUGH = "enough"
    """The plan's stopping rule ended it; every fired A-line is stored."""
    ABORTED = "aborted"


class SessionControl:
    """Interface through which a scan session receives commands and reports progress; base class without stops.

    Parameters
    ----------
    progress
        Callback that receives the number of stored A-lines.
    cancelled
        Callback that ends the session when it returns ``True``: laser off, fired A-lines are stored.
    """

    can_ask = False
    """Whether :meth:`decide` may obtain a decision later, from a person."""

    def __init__(self, progress: Progress | None = None, cancelled: CancelCheck | None = None) -> None:
        self._progress, self._cancelled = progress, cancelled

    def monitor(self, scanner: fabry_perot.Scanner) -> AbstractContextManager[None]:
        """Context manager that monitors a connected scanner during the block; does nothing in the base class."""
        return nullcontext()

    def may_fire(self, allowed: bool) -> None:
        """Handle the announcement that the scanner may fire from now on, or that it no longer may."""

    def command(self) -> Command:
        """Return the current command to the session; called about twenty times a second."""
        return Command.SHUTDOWN if self._cancelled is not None and self._cancelled() else Command.RUN

    def on_phase(self, phase: SessionPhase) -> None:
        """Handle a phase change of the session."""

    def on_laser_off(self) -> None:
        """Handle the scanner's confirmation that its laser is off, after :attr:`Command.SHUTDOWN`."""

    def on_enough(self, reason: str) -> None:
        """Handle the end of the scan by its stopping rule, with the reason."""

    def on_storage_blocked(self, why: str | None) -> None:
        """Handle the reason why A-lines cannot be stored at present; ``None`` when storing works again."""

    def on_stages(self, stages: tuple[StageRecord, ...], plan: ScanPlan) -> None:
        """Handle the stages that a scan file has, and the plan of all of them."""

    def on_proposals(self, number: int, proposals: tuple[Proposal, ...]) -> None:
        """Handle the proposals for the points of interest of a stage."""

    def decision(self, number: int) -> tuple[Points, str] | None:
        """Return a decision on a stage that is stored already, and its author; ``None``: there is none."""
        return None

    def decide(self, number: int, proposed: Points) -> tuple[Points, str] | None:
        """Return the points of interest of a stage and the author of the decision; ``None``: not decided yet.

        Parameters
        ----------
        number
            Number of the stage.
        proposed
            Points that are taken where no person has chosen others; empty: a person must choose.
        """
        return (proposed, "auto") if proposed else None

    def progress(self, done: int, total: int) -> None:
        """Report the number of stored A-lines to the progress callback."""
        if self._progress is not None:
            self._progress("A-lines", done, total)

    def wait(self, seconds: float) -> None:
        """Wait for a time in seconds before the session's next poll."""
        time.sleep(seconds)
