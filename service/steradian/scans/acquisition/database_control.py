"""Scan control through the database: reads the desired state and reports progress, in its own thread."""

from __future__ import annotations

import contextvars
import logging
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from sqlalchemy.exc import SQLAlchemyError

import fabry_perot
from steradian.core.exceptions import ScanFailed, SteradianError
from steradian.plans import ScanPlan
from steradian.plans.stages import Points, Proposal, StageRecord
from steradian.scans.acquisition.emergency_watchdog import EmergencyWatchdog
from steradian.scans.acquisition.session_control import Command, SessionControl, SessionPhase
from steradian.storage.db.tables import ScanRow
from steradian.storage.repositories.scan_stages import ScanStageRepository, StageState
from steradian.storage.repositories.scanner_lease_and_stop import ScannerRepository
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import DesiredScanState, ScanState, shortest_path

POLL = 0.2
"""Seconds between looks for work, and between looks at what is wished of a scan and reports of its progress."""
_log = logging.getLogger(__name__)
_S = ScanState
STATE_BY_PHASE = {
    SessionPhase.RUNNING: (_S.RUNNING, "A-lines are stored"),
    SessionPhase.RECOVERING: (_S.RECOVERING, "the scanner is silent or its link is lost; reconnecting"),
    SessionPhase.RESCUING: (_S.RECOVERING, "the A-lines fired before are fetched from the scanner"),
    SessionPhase.PAUSING: (_S.PAUSING, ""),
    SessionPhase.PAUSED: (_S.PAUSED, "the laser is off; the fired A-lines are stored"),
    SessionPhase.PLANNING: (_S.PAUSED, "the laser is off; the next stage is made from the image"),
    SessionPhase.DECIDING: (_S.PAUSED, "the laser is off until a point of interest is chosen"),
    SessionPhase.ARMING: (_S.ARMING, ""),
    SessionPhase.STOPPING: (_S.STOPPING, ""),
    SessionPhase.ABORTING: (_S.ABORTING, ""),
}
"""State of a scan at each phase, and why; where it says nothing a person wished it."""
COMMAND_BY_DESIRED_STATE = {
    DesiredScanState.RUNNING: Command.RUN,
    DesiredScanState.PAUSED: Command.PAUSE,
    DesiredScanState.STOPPED: Command.STOP,
    DesiredScanState.ABORTED: Command.ABORT,
}


class DatabaseControl(SessionControl):
    """Session control that reads the scan's desired state from the database and writes its progress and state.

    A thread does all database access every :data:`POLL` seconds, so a locked or unavailable database does not delay
    the storing of A-lines. Until it is available the last known command holds; changes are written later, in order.

    Parameters
    ----------
    scans, identifier
        The scan.
    stopping
        Event that is set when the service ends; the session then aborts.
    emergency
        Watchdog that stops the scanner independently; the session then receives the command to abort.
    """

    can_ask = True

    def __init__(
        self, scans: ScanRepository, identifier: str, stopping: threading.Event, emergency: EmergencyWatchdog
    ) -> None:
        super().__init__()
        self._scans, self._id, self._stopping, self._emergency = scans, identifier, stopping, emergency
        self._stages = ScanStageRepository(scans.database, scans.clock)
        self._decisions: dict[int, tuple[Points, str]] = {}
        self._claimed: set[int] = set()
        self.enough = ""
        """Why the stopping rule has ended the scan; empty: it has not."""
        self._row = ScannerRepository(scans.database, scans.clock, scans.scanner_id)
        self._wish, self._why, self._who = Command.RUN, "", "acquisition"
        self._notes: deque[Callable[[], None]] = deque()
        self._last: tuple[str, int, int] | None = None
        self._reported: tuple[str, int, int] | None = None
        self._failure: SteradianError | None = None
        self._answers = True
        self._news, self._closing = threading.Event(), threading.Event()
        self._settle()
        context = contextvars.copy_context()  # so that its lines bear the scan's request, too
        self._clerk = threading.Thread(target=context.run, args=(self._work,), name="scan-watch", daemon=True)
        self._clerk.start()

    @contextmanager
    def monitor(self, scanner: fabry_perot.Scanner) -> Iterator[None]:
        """Context manager during which emergency stops switch off the laser of a connected scanner."""
        with self._emergency.protect(scanner):
            yield

    def may_fire(self, allowed: bool) -> None:
        """Report to the emergency watchdog whether the scanner may fire."""
        self._emergency.may_fire(allowed)

    def command(self) -> Command:
        """Return the command for the scan's desired state; raises the error that forbids the scan to continue."""
        if self._stopping.is_set() or self._emergency.standing is not None:
            return Command.ABORT
        if self._failure is not None:
            raise self._failure
        return self._wish

    def on_enough(self, reason: str) -> None:
        """Take the reason why the scan has enough points as the reason of its end."""
        self.enough = reason

    def on_phase(self, phase: SessionPhase) -> None:
        """Schedule the state transition of the scan's database row for a phase of the session."""
        if self._stopping.is_set():
            return  # it is to be interrupted
        press = self._emergency.standing
        why, who = (self._why, self._who) if press is None else (press.why, press.who)
        if self.enough and phase is SessionPhase.STOPPING:
            why, who = self.enough, "acquisition"
        self._note(lambda: self._lead(phase, why, who))

    def on_stages(self, stages: tuple[StageRecord, ...], plan: ScanPlan) -> None:
        """Schedule the writing of the stages that the scan file has to the database."""
        self._note(lambda: self._stages.set_made(self._id, stages, plan))

    def on_proposals(self, number: int, proposals: tuple[Proposal, ...]) -> None:
        """Schedule the writing of the proposals of a stage to the database."""
        self._note(lambda: self._stages.propose(self._id, number, proposals))

    def decision(self, number: int) -> tuple[Points, str] | None:
        """Return the decision on a stage that the database has."""
        return self._decisions.get(number)

    def decide(self, number: int, proposed: Points) -> tuple[Points, str] | None:
        """Return the decision on a stage from the database; the first of a person and of the rule counts."""
        if proposed and number not in self._claimed:
            self._claimed.add(number)
            self._note(lambda: self._stages.decide_by_rule(self._id, number, proposed))
        return self._decisions.get(number)

    def progress(self, done: int, total: int) -> None:
        """Record the number of stored A-lines for the next write to the database."""
        self._last = ("A-lines", done, total)

    def on_storage_blocked(self, why: str | None) -> None:
        """Record in the database that the scan is paused because the disk is full, or that it continues."""
        _log.warning("scan %s: %s", self._id, why or "A-lines can be stored again")
        self._note(lambda: self._tell(why))

    def wait(self, seconds: float) -> None:
        """Wait for a time in seconds, or until the service ends."""
        self._stopping.wait(seconds)

    def flush(self) -> None:
        """Write pending changes to the database; retry until the database is available or the service ends."""
        self.close()
        while self._is_behind and self._failure is None:
            self._settle()
            if self._is_behind and self._stopping.wait(1.0):
                return

    def close(self) -> None:
        """End the database thread and discard pending changes."""
        self._closing.set()
        self._news.set()
        self._clerk.join()

    def _note(self, deed: Callable[[], None]) -> None:
        self._notes.append(deed)
        self._news.set()

    def _work(self) -> None:
        while not self._closing.is_set():
            self._news.wait(POLL)
            self._news.clear()
            self._settle()

    @property
    def _is_behind(self) -> bool:
        return bool(self._notes) or self._last != self._reported

    def _settle(self) -> None:
        """Read the desired state and write pending changes; on database errors, leave them for the next poll."""
        try:
            row = self._scans.get(self._id)
            self._why, self._who = row.reason or "requested", row.wished_by or "acquisition"
            self._wish = COMMAND_BY_DESIRED_STATE[row.desired_state]
            self._read_decisions(row)
            while self._notes:
                self._notes[0]()
                self._notes.popleft()
            self._report_progress()
            self._answers = True
        except SQLAlchemyError as error:
            if self._answers:
                _log.warning("scan %s continues without the database: %s", self._id, error)
            self._answers = False
        except SteradianError as error:
            self._failure = error
        except Exception as error:  # a thread that ended unseen would never hear a wish to stop
            _log.exception("the desired state of scan %s cannot be read", self._id)
            self._failure = ScanFailed(f"the desired state of the scan cannot be read: {error}")

    def _report_progress(self) -> None:
        if (last := self._last) is not None and last != self._reported:
            self._scans.report(self._id, *last)
            self._reported = last

    def _lead(self, phase: SessionPhase, reason: str, person: str) -> None:
        """Transition the scan's row through valid states to the state that matches a phase of the session."""
        present = self._scans.get(self._id).state
        state, why = STATE_BY_PHASE.get(phase, (present, ""))
        if phase in (SessionPhase.PLANNING, SessionPhase.DECIDING):
            self._report_progress()
            self._scans.report_condition(self._id, f"{phase} the next stage", why)
        if state is present:
            return
        for following in shortest_path(present, state):
            self._scans.transition(self._id, following, why=why or reason, who="acquisition" if why else person)
        if state in {_S.PAUSED, _S.ARMING, _S.RUNNING}:
            self._row.note_state("paused" if state is _S.PAUSED else "scanning")

    def _read_decisions(self, row: ScanRow) -> None:
        for stage in row.stages or ():
            if stage["state"] == StageState.DECIDED:
                points = tuple((x, y, depth) for x, y, depth in stage["points_of_interest"])
                self._decisions[stage["number"]] = points, stage["decided_by"]

    def _tell(self, why: str | None) -> None:
        stage, reason = (f"blocked: {why}", why) if why else ("A-lines", "A-lines can be stored again")
        if self._scans.get(self._id).stage != stage:
            self._scans.report_condition(self._id, stage, reason)
