"""Scan session: acquisition over one scanner connection into a scan file.

Each batch of A-lines is stored before it is acknowledged, in order, so the scanner retains all A-lines that are not
in the file, also after a failed write. An upload has only the rows to be measured, and a tag that the file records:
a later session recognises by the tag whether the A-lines that the scanner still holds belong to this scan.
"""

from __future__ import annotations

import logging
import secrets
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

import fabry_perot
from fabry_perot.clock import RealClock
from fabry_perot.wire.states import HoldCause
from steradian.core.exceptions import ScanInterrupted
from steradian.scans.acquisition.end_requests import hearing
from steradian.scans.acquisition.excitation import tune_excitation
from steradian.scans.acquisition.session_control import (
    TERMINAL_COMMANDS,
    Command,
    SessionControl,
    SessionOutcome,
    SessionPhase,
)
from steradian.scans.file.create import is_disk_full_error
from steradian.scans.file.measurement_order import ProgramSegment, ScanProgram
from steradian.scans.file.writer import ScanFileWriter, UploadRecord

_log = logging.getLogger(__name__)
DEFAULT = fabry_perot.RecoveryPolicy()
POLL_INTERVAL = 0.1
"""Seconds between two polls of the command while the laser does not fire."""
STALE_AFTER = 3.0
"""Seconds without a message from the scanner after which the scan does not count as running."""
MAX_TRIES = 30
"""Attempts of a request whose link is lost, before the scan fails."""
INSISTENCE, ARMING = 12.0, 3.0
"""Seconds after which a request is not retried: in a running scan, and before the first shot."""
RETRY_INTERVAL = 1.0
"""Seconds between two attempts to write to a full disk."""
_STOPPED = frozenset({HoldCause.REQUEST, HoldCause.CLEARED})
"""Causes of a stop that this session did not request."""
ResultT = TypeVar("ResultT")
URGENT = frozenset({Command.SHUTDOWN, Command.ABORT})
"""Commands after which a request is not retried."""
_HALTED_PHASES = frozenset({"paused", "safe_hold", "ready"})
"""States in which a scanner fires again only after a command."""


class ScanSession:
    """Scan session: measures rows of a scan file over one scanner connection.

    Parameters
    ----------
    scanner
        Connected.
    store
        The scan file.
    control
        Source of commands, and receiver of phases and progress.
    within
        Seconds of a full disk after which the laser fires again only after a resume command from a person.
    """

    def __init__(
        self,
        scanner: fabry_perot.Scanner,
        store: ScanFileWriter,
        control: SessionControl,
        within: float = DEFAULT.within,
    ) -> None:
        self._scanner, self._store, self._control = scanner, store, control
        self._course: ScanProgram = store.course
        self._rows: NDArray[np.int64] = np.zeros(0, np.int64)
        self._taken: deque[Sequence[fabry_perot.ALine]] = deque()
        """Batches that are not stored yet, in order: the scanner still holds them, but sends each once."""
        self._fired_before = self._shots_before = 0
        self._phase: SessionPhase | None = None
        self._within = within
        self._enough: Callable[[], str] = str
        self._fires = False
        """Whether the laser is to fire, were it not for something that passes."""
        self._rested = 0.0
        """Seconds for which it has not, if that was too long."""

    def drain_previous_upload(self) -> int:
        """Store A-lines of the previous upload that the scanner still holds; return their number.

        After this process was killed the scanner holds A-lines that were fired and never acknowledged.
        """
        last = self._store.last_upload()
        if last is None:
            return 0
        before = self._store.stored
        try:
            self._course.upload(self._scanner, last.rows, last.tag, resume=True)
        except fabry_perot.PlanInvalid:
            return 0  # it has booted since, or measured something else
        self._rows = last.rows
        self._taken.clear()
        self._drain()
        self._count(last.fired + self._laser_shots() - last.laser_shots)
        return self._store.stored - before

    def acquire(
        self, wanted: NDArray[np.bool_], *, last: bool = True, enough: Callable[[], str] = str
    ) -> SessionOutcome:
        """Measure the rows selected by ``wanted`` (F·M,) in the order of interrogation.

        Parameters
        ----------
        wanted
            Rows to measure.
        last
            Whether the scan is complete with them; otherwise a further stage follows.
        enough
            Asked at each batch for the reason why the plan's stopping rule ends the scan now; empty: it goes on.

        Raises
        ------
        fabry_perot.ScannerError
            When the scanner or its link gave up; every acknowledged A-line is stored.
        """
        end, self._enough = SessionOutcome.COMPLETE, enough
        for segment in self._course.iter_segments(wanted):
            wish = self._control.command()
            if wish in TERMINAL_COMMANDS:
                return self.leave(wish)
            end = self._measure(segment)
            if end is not SessionOutcome.COMPLETE:
                return end
        if last:
            self._enter(SessionPhase.COMPLETING)
        return end

    def _measure(self, segment: ProgramSegment) -> SessionOutcome:
        if self._phase not in {SessionPhase.RUNNING, SessionPhase.RESCUING}:
            self._enter(SessionPhase.ARMING)
        tag = 1 + secrets.randbelow(0xFFFFFFFE)
        with hearing(self._scanner, self._control):
            tune_excitation(self._scanner, segment.excitation)
            try:
                upload = UploadRecord(segment.rows, tag, self._store.fired, self._laser_shots(TERMINAL_COMMANDS))
            except fabry_perot.LinkError:
                if (wish := self._control.command()) not in TERMINAL_COMMANDS:
                    raise
                self.leave(Command.ABORT)
                return SessionOutcome.ABORTED if wish is Command.ABORT else SessionOutcome.STOPPED
        if not self._store_patiently(lambda: self._store.record_upload(upload)):
            return self.leave(self._control.command())
        with hearing(self._scanner, self._control):
            self._course.upload(self._scanner, segment.rows, tag)
        if (wish := self._control.command()) in TERMINAL_COMMANDS:
            return self.leave(wish)
        self._rows = segment.rows
        self._taken.clear()
        self._fired_before, self._shots_before = self._store.fired, self._scanner.status.shots
        try:
            if (early := self._start()) is not None:
                return self.leave(early)
            while (end := self._take()) is None:
                pass
            if end is SessionOutcome.ABORTED:
                self._note_fired()
                return end
            self._report_fired()
        except BaseException:
            self._note_fired()
            raise
        finally:
            self._may_fire(False)
        return end

    def _start(self) -> Command | None:
        """Arm and start the scanner; return a stop command that arrived before, else ``None``."""
        self._may_fire(True)
        with hearing(self._scanner, self._control):
            token = self._scanner.arm()
            if (
                wish := self._control.command()
            ) in TERMINAL_COMMANDS:  # wished before ARM; an abort after it spends the token
                return wish
            self._scanner.start(token)
        return None

    def _may_fire(self, allowed: bool) -> None:
        self._fires = allowed
        self._control.may_fire(allowed)

    def _after_a_lapse(self, lapse: fabry_perot.LeaseExpired) -> SessionOutcome | None:
        """Handle an expired laser lease: execute a pending pause or end command, else raise ``lapse``."""
        wish = self._control.command()
        if wish is Command.PAUSE:
            wish = self._pause()
            if wish is Command.RUN:
                return None
        if wish in TERMINAL_COMMANDS:
            return self.leave(wish)
        raise lapse

    def _laser_shots(self, ending: frozenset[Command] = URGENT) -> int:
        """Return the laser's own shot counter, which survives reboots of the scanner."""
        return int(self._insist(self._scanner.statistics, ending)["laser_shots"])

    def _take(self) -> SessionOutcome | None:
        """Store received A-lines and execute commands; return the outcome, ``None`` to continue after a pause."""
        try:
            for batch in self._scanner.alines(idle=True):
                if batch and not self._keep(batch):
                    return self.leave(self._control.command())
                if self._rested:
                    self._drain()
                    raise ScanInterrupted(
                        f"the laser rested {self._rested:.0f} s because of a full disk; the fired A-lines are"
                        " stored; resume when it may fire again"
                    )
                recovering = self._scanner.is_recovering or self._scanner.seconds_since_heard > STALE_AFTER
                if recovering:
                    self._enter(SessionPhase.RECOVERING)
                elif self._phase is SessionPhase.RECOVERING or batch:
                    self._enter(SessionPhase.RUNNING)
                wish = self._control.command()
                if wish is Command.PAUSE and not recovering:
                    wish = self._pause()
                if wish in TERMINAL_COMMANDS and not (wish is Command.STOP and recovering):
                    return self.leave(wish)
                if not recovering and (reason := self._enough()):
                    self._control.on_enough(reason)
                    self.leave(Command.STOP)
                    return SessionOutcome.ENOUGH
        except fabry_perot.LeaseExpired as lapse:
            return self._after_a_lapse(lapse)
        except fabry_perot.ScanAborted:
            if self._control.command() is not Command.ABORT:
                raise
            return self.leave(Command.ABORT)
        return SessionOutcome.COMPLETE

    def _pause(self) -> Command:
        """Stop firing, store fired shots, wait for the next command and return it."""
        self._enter(SessionPhase.PAUSING)
        self._halt()
        self._enter(SessionPhase.PAUSED)
        self._note_fired()
        while (wish := self._control.command()) is Command.PAUSE:
            self._control.wait(POLL_INTERVAL)
        if wish is Command.RUN:
            self._enter(SessionPhase.ARMING)
            self._may_fire(True)
            self._go_on()
        return wish

    def leave(self, wish: Command) -> SessionOutcome:
        """End the session early at a stop, abort or shutdown command, and return the outcome."""
        if wish is Command.STOP:
            self._enter(SessionPhase.STOPPING)
            self._halt()
            return SessionOutcome.STOPPED
        self._enter(SessionPhase.ABORTING)
        self._fires = False
        if wish is Command.ABORT:
            answer = self._scanner.stop_laser("the scan's own abort")  # not left before the scanner says that it is off
            if answer.laser != "off":
                _log.warning("the abort is not confirmed; the laser switches off by its lease: %s", answer.detail)
            return SessionOutcome.ABORTED
        try:
            self._scanner.abort("laser-off")
        except fabry_perot.ScannerError as error:  # it does not hear us: then its lease is not renewed either
            _log.warning("the scanner does not answer the abort; its laser switches off by its lease: %s", error)
            return SessionOutcome.ABORTED
        self._control.on_laser_off()
        self._drain()
        return SessionOutcome.STOPPED

    def _halt(self) -> None:
        """Stop firing and store the A-lines of shots already fired."""
        self._fires = False
        self._rest()
        self._control.may_fire(False)
        self._drain()

    def _rest(self) -> None:
        """Pause the scanner's firing; no error if it has already stopped."""
        try:
            self._insist(self._scanner.pause)
        except fabry_perot.RequestRejected:  # it stands already: done, or the lease has lapsed
            return

    def _drain(self) -> None:
        """Receive and store the A-lines that the scanner still holds, without firing."""
        if not self._keep():
            return
        try:
            for batch in self._scanner.alines(idle=True):
                if batch and not self._keep(batch):
                    return
                if not self._scanner.has_pending_data:
                    return
        except (fabry_perot.LeaseExpired, fabry_perot.ScanAborted):
            return

    def _keep(self, batch: Sequence[fabry_perot.ALine] = ()) -> bool:
        """Store and acknowledge batches in order; return False if ended by command while the disk was full.

        An acknowledgement frees all A-lines up to its own. Batches that could not be stored therefore come first, and
        no other method acknowledges.
        """
        if batch:
            if self._phase is None:
                self._enter(SessionPhase.RESCUING)
            self._taken.append(batch)
        while self._taken:
            first = self._taken[0]
            if not self._store_patiently(partial(self._store.append, first, self._rows)):
                return False
            self._scanner.acknowledge(first[-1])
            self._taken.popleft()
            self._note_fired()
            self._control.progress(self._store.stored, self._store.count)
        return True

    def _store_patiently(self, write: Callable[[], None]) -> bool:
        """Write A-lines; while the disk is full, pause the laser and retry. Returns False on an end command."""
        blocked, clock = False, RealClock()
        while True:
            try:
                write()
                break
            except OSError as error:
                if not is_disk_full_error(error):
                    raise
            if not blocked:
                since = clock.now()
                self._rest()
            blocked = True
            self._control.on_storage_blocked(f"the disk of {self._store.path} is full")
            if self._control.command() in TERMINAL_COMMANDS:
                return False
            self._control.wait(RETRY_INTERVAL)
        if blocked:
            self._control.on_storage_blocked(None)
            if self._fires and self._control.command() is Command.RUN:
                rested = (clock.now() - since) * 1e-6
                if rested > self._within or not self._go_on(by_itself=True):
                    self._fires, self._rested = False, rested
        return True

    def _go_on(self, *, by_itself: bool = False) -> bool:
        """Resume firing if points remain and no other host stopped the scanner; return whether allowed.

        With ``by_itself`` no person requested the resumption; the scanner's own rule then decides, immediately before
        the laser starts.
        """
        if self._scanner.state in _HALTED_PHASES and self._scanner.status.cause not in _STOPPED:
            try:
                self._insist(partial(self._scanner.resume, by_itself=by_itself, unless=self._is_to_end))
            except fabry_perot.LeaseExpired as error:
                _log.warning("the scan was not taken up again: %s", error)
                return False
            except fabry_perot.ScanAborted as error:
                if not self._is_to_end():
                    raise
                _log.info("the scan was not taken up again: %s", error)
            except (
                fabry_perot.RequestRejected
            ) as error:  # its state has changed meanwhile; what it is now, the next look tells
                _log.info("the scan was not taken up again: %s", error)
        return True

    def _is_to_end(self) -> bool:
        return self._control.command() in TERMINAL_COMMANDS

    def _insist(self, request: Callable[[], ResultT], ending: frozenset[Command] = URGENT) -> ResultT:
        """Retry a scanner request after link failures, until an ``ending`` command or a timeout.

        Before the first shot the time limit is shorter.
        """
        arming, clock = self._phase in (None, SessionPhase.ARMING), RealClock()
        deadline = clock.now() + int(1e6 * (ARMING if arming else INSISTENCE))
        for left in reversed(range(MAX_TRIES)):
            try:
                return request()
            except (fabry_perot.LinkLost, fabry_perot.ResponseTimeout):
                if (
                    not left
                    or clock.now() > deadline
                    or self._control.command() in (TERMINAL_COMMANDS if arming else ending)
                ):
                    raise
            self._control.wait(POLL_INTERVAL)
        raise AssertionError

    def _report_fired(self) -> None:
        """Record the shot count from the scanner's report of this upload; a missing report is only logged."""
        try:
            self._count(self._fired_before + self._insist(self._scanner.report).fired)
        except fabry_perot.ScannerError as error:
            _log.warning("the scanner does not report its shot count: %s", error)
            self._note_fired()

    def _note_fired(self) -> None:
        """Record the shot count from the scanner's latest status; after a reboot that count restarts at 0."""
        if self._phase not in {None, SessionPhase.RESCUING}:  # the shots of the session before count otherwise
            self._count(self._fired_before + self._scanner.status.shots - self._shots_before)

    def _count(self, fired: int) -> None:
        """Store the number of shots fired; a smaller number reported by the scanner does not reduce it."""
        fired = max(fired, self._store.stored // self._course.beams * self._course.averages)
        if fired > self._store.fired:
            self._store.record_shot_count(fired)

    def _enter(self, phase: SessionPhase) -> None:
        if phase is not self._phase:
            self._phase = phase
            self._control.on_phase(phase)
