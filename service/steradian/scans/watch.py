"""Between a session and the database: what is wished of the scan, how far it is, and its state."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager

from sqlalchemy.exc import DBAPIError

import fabry_perot
from steradian.scans.control import Control, Phase, Wish
from steradian.scans.emergency import EmergencyWatch
from steradian.storage.scans import ScanRepository
from steradian.storage.states import DesiredScanState, ScanState, route

POLL = 0.2
"""Seconds between looks for work, at what is wished of a scan, and between progress reports."""
_log = logging.getLogger(__name__)
_S = ScanState
_STATES = {
    Phase.RUNNING: (_S.RUNNING, "A-lines are stored"),
    Phase.RECOVERING: (_S.RECOVERING, "the link is lost; it is being taken up again"),
    Phase.PAUSING: (_S.PAUSING, ""),
    Phase.PAUSED: (_S.PAUSED, "the laser is off; what was fired is stored"),
    Phase.ARMING: (_S.ARMING, ""),
    Phase.STOPPING: (_S.STOPPING, ""),
    Phase.ABORTING: (_S.ABORTING, ""),
}
"""State of a scan at each phase, and why; where it says nothing a person wished it."""
_WISHES = {
    DesiredScanState.RUNNING: Wish.RUN,
    DesiredScanState.PAUSED: Wish.PAUSE,
    DesiredScanState.STOPPED: Wish.STOP,
    DesiredScanState.ABORTED: Wish.ABORT,
}


class ScanWatch(Control):
    """Writes progress and states of one scan, and reads wishes, the latter at most every :data:`POLL` seconds.

    A database that does not answer never holds up the A-lines: what it missed it learns when it is back.

    Parameters
    ----------
    scans, identifier
        The scan.
    stopping
        Set when the service ends: then the session aborts.
    clock
        Seconds.
    emergency
        Stops the scanner by itself; the session then learns that the scan is to be aborted.
    """

    def __init__(
        self,
        scans: ScanRepository,
        identifier: str,
        stopping: threading.Event,
        clock: Callable[[], float],
        emergency: EmergencyWatch,
    ) -> None:
        super().__init__()
        self._scans, self._id, self._stopping, self._clock = scans, identifier, stopping, clock
        self._emergency = emergency
        self._written = self._asked = float("-inf")
        self._last: tuple[str, int, int] | None = None
        self._wish = Wish.RUN
        self._reason, self._who = "", "acquisition"
        self._phase: Phase | None = None

    def guarding(self, scanner: fabry_perot.Scanner) -> AbstractContextManager[None]:
        """Have the emergency stop reach a connected scanner until the block ends."""
        return self._emergency.guarding(scanner)

    def wish(self) -> Wish:
        """Return what is wanted now."""
        if self._stopping.is_set():
            return Wish.ABORT
        if (press := self._emergency.standing) is not None:
            self._reason, self._who = press.why, press.who
            return Wish.ABORT
        if self._clock() - self._asked >= POLL:
            self._asked = self._clock()
            try:
                row = self._scans.get(self._id)
                self._wish = _WISHES[row.desired_state]
                self._reason, self._who = row.reason or "requested", row.wished_by or "acquisition"
                if self._phase is not None:
                    self._lead(row.state)
            except DBAPIError as error:
                _log.warning("what is wished of scan %s cannot be read: %s", self._id, error.orig)
        return self._wish

    def enter(self, phase: Phase) -> None:
        """Lead the scan to the state of a phase."""
        self._phase = phase
        if self._stopping.is_set():
            return  # it is to be interrupted
        try:
            self._lead(self._scans.get(self._id).state)
        except DBAPIError as error:
            _log.warning("scan %s is now %s, which cannot be noted: %s", self._id, phase, error.orig)

    def _lead(self, present: ScanState) -> None:
        """Bring the scan's state in line with the session's phase."""
        state, why = _STATES.get(self._phase or Phase.COMPLETING, (present, ""))
        if state is present:
            return
        who = "acquisition" if why else self._who
        for following in route(present, state):
            self._scans.transition(self._id, following, why=why or self._reason, who=who)

    def progress(self, done: int, total: int) -> None:
        """Note how far the scan is."""
        self._last = ("A-lines", done, total)
        if self._clock() - self._written < POLL:
            return
        self._written = self._clock()
        try:
            self._scans.report(self._id, *self._last)
        except DBAPIError as error:  # the A-lines go on into the file
            _log.warning("progress of scan %s is lost: %s", self._id, error.orig)

    def blocked(self, why: str | None) -> None:
        """Note that the scan stands because nothing can be stored, or goes on."""
        _log.warning("scan %s: %s", self._id, why or "A-lines can be stored again")
        stage, reason = (f"blocked: {why}", why) if why else ("A-lines", "A-lines can be stored again")
        try:
            if self._scans.get(self._id).stage != stage:
                self._scans.tell(self._id, stage, reason)
        except DBAPIError as error:
            _log.warning("that scan %s is blocked cannot be noted: %s", self._id, error.orig)

    def wait(self, seconds: float) -> None:
        """Let time pass, unless the service ends."""
        self._stopping.wait(seconds)

    def over(self) -> None:
        """Write the last progress; waits for a database that does not answer."""
        while self._last is not None:
            try:
                return self._scans.report(self._id, *self._last)
            except DBAPIError:
                if self._stopping.wait(1.0):
                    return None
        return None
