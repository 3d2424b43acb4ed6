"""Repository of scans: the only code that changes their state."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any, Self

from sqlalchemy import ColumnElement, func, select, update
from sqlalchemy.orm import Session

from steradian.core.exceptions import Conflict
from steradian.core.logging_config import bind_request_id, request_id
from steradian.storage.db.database import Database
from steradian.storage.db.tables import PlanRow, ScannerRow, ScanRow
from steradian.storage.db.timestamps_and_ids import Clock, new_id, utc_now
from steradian.storage.repositories.base import Repository
from steradian.storage.repositories.event_log import append_event
from steradian.storage.repositories.references import lock_row
from steradian.storage.repositories.scan_stages import planned_stages
from steradian.storage.repositories.scanner_lease_and_stop import SCANNER_ID
from steradian.storage.state_machines import (
    ACTIVE_SCAN_STATES,
    ALLOWED_DESIRED_STATES,
    IRREVERSIBLE_DESIRED_STATES,
    DesiredScanState,
    ScanState,
    is_terminal,
    require_transition,
)

_log = logging.getLogger(__name__)


class ScanRepository(Repository[ScanRow]):
    """Repository of scans with their states and history.

    Parameters
    ----------
    scanner_id
        Scanner whose scans are selected by methods without an identifier.
    """

    kind, table = "scan", ScanRow

    def __init__(self, database: Database, clock: Clock = utc_now, scanner_id: str = SCANNER_ID) -> None:
        super().__init__(database, clock)
        self.scanner_id = scanner_id

    def of(self, scanner_id: str) -> Self:
        """Return the repository for another scanner."""
        return type(self)(self.database, self.clock, scanner_id)

    def queue(self, plan: PlanRow, *, simulated: bool) -> ScanRow:
        """Insert a queued scan of a plan, in a transaction of its own."""
        with self.database.write() as session:
            return self.add(session, plan, simulated=simulated, scanner_id=self.scanner_id)

    def add(
        self,
        session: Session,
        plan: PlanRow,
        *,
        simulated: bool,
        labels: dict[str, str] | None = None,
        fence: int = 0,
        who: str = "local",
        completes: str | None = None,
        scanner_id: str = SCANNER_ID,
    ) -> ScanRow:
        """Insert a queued scan of a plan, in the caller's transaction.

        Parameters
        ----------
        scanner_id
            Scanner that runs the scan.
        completes
            Partial scan of this plan to continue; only missing A-lines are measured.
        fence
            Number of the scanner lease of the request.
        who
            Principal that requests the scan.
        """
        lock_row(session, "plan", plan.id)
        if completes is not None:
            lock_row(session, "scan", completes)
        now = self.clock()
        row = ScanRow(
            id=new_id("s"),
            plan_id=plan.id,
            mask_id=plan.mask_id,
            stages=planned_stages(plan),
            scanner_id=scanner_id,
            completes=completes,
            request_id=request_id.get() or None,
            simulated=simulated,
            labels=labels or {},
            fence=fence,
            state=ScanState.QUEUED,
            desired_state=DesiredScanState.RUNNING,
            created=now,
            done=0,
            total=0,
            summary=None,
            history=[{"state": ScanState.QUEUED, "at": now.isoformat(), "who": who, "why": "requested"}],
        )
        session.add(row)
        session.flush()
        append_event(session, now, "scan", row.id, {"state": row.state, "who": who, "why": "requested"})
        return row

    def next_queued(self) -> ScanRow | None:
        """Return the scanner's oldest queued scan; ``None`` if there is none."""
        query = select(ScanRow).where(self._mine(ScanState.QUEUED)).order_by(ScanRow.sequence).limit(1)
        with self.database.read() as session:
            return session.scalars(query).first()

    def under_way(self) -> list[ScanRow]:
        """Return the active scans of all scanners."""
        with self.database.read() as session:
            return list(session.scalars(select(ScanRow).where(ScanRow.state.in_(ACTIVE_SCAN_STATES))))

    def unfinished(self) -> list[ScanRow]:
        """Return the scanner's scans that are not in a terminal state."""
        over = [state for state in ScanState if is_terminal(state)]
        query = select(ScanRow).where(ScanRow.scanner_id == self.scanner_id, ScanRow.state.not_in(over))
        with self.database.read() as session:
            return list(session.scalars(query.order_by(ScanRow.sequence)))

    def to_settle(self) -> list[ScanRow]:
        """Return the scanner's interrupted scans with the desired state stopped or aborted."""
        wishes = (DesiredScanState.STOPPED, DesiredScanState.ABORTED)
        query = select(ScanRow).where(self._mine(ScanState.INTERRUPTED), ScanRow.desired_state.in_(wishes))
        with self.database.read() as session:
            return list(session.scalars(query))

    def to_resume(self) -> ScanRow | None:
        """Return the scanner's oldest interrupted scan with the desired state running."""
        wished = ScanRow.desired_state == DesiredScanState.RUNNING
        query = select(ScanRow).where(self._mine(ScanState.INTERRUPTED), wished).order_by(ScanRow.sequence)
        with self.database.read() as session:
            return session.scalars(query.limit(1)).first()

    def clear_desired_running(self, why: str) -> None:
        """Set the desired state of interrupted scans from running to paused, because the service was restarted."""
        wished = ScanRow.desired_state == DesiredScanState.RUNNING
        query = select(ScanRow).where(self._mine(ScanState.INTERRUPTED), wished)
        with self.database.write() as session:
            for row in session.scalars(query.with_for_update()):
                row.desired_state, row.reason = DesiredScanState.PAUSED, why
                data = {"state": row.state, "desired_state": row.desired_state, "who": "acquisition", "why": why}
                append_event(session, self.clock(), "scan", row.id, data)

    def counts(self) -> dict[str, int]:
        """Count the scans in each state."""
        query = select(ScanRow.state, func.count()).group_by(ScanRow.state)
        with self.database.read() as session:
            return {str(state): count for state, count in session.execute(query)}

    def transition(
        self,
        identifier: str,
        following: ScanState,
        *,
        why: str,
        who: str = "acquisition",
        error: tuple[str, str] | None = None,
        summary: dict[str, Any] | None = None,
    ) -> ScanRow:
        """Change a scan's state if the transition table allows it, and append to its history.

        The desired state of a scan that is interrupted changes from running to paused: only a person resumes it.

        Parameters
        ----------
        error
            Code and text of what went wrong.
        summary
            Counts and figures of the run, when it is over.

        Raises
        ------
        Conflict
            When the table has no such transition.
        """
        now = self.clock()
        with self.database.write() as session:
            row = self._find(session, identifier, lock=True)
            require_transition(identifier, row.state, following)
            row.state = following
            row.history = [*row.history, {"state": following, "at": now.isoformat(), "who": who, "why": why}]
            if following is ScanState.RUNNING and row.started is None:
                row.started = now
            if is_terminal(following):
                row.ended = now
            if following is ScanState.INTERRUPTED and row.desired_state is DesiredScanState.RUNNING:
                row.desired_state = DesiredScanState.PAUSED
            if following is ScanState.RUNNING:
                row.error_code = row.error = None
            if error is not None:
                row.error_code, row.error = error
            if summary is not None:
                row.summary = summary
            append_event(session, now, "scan", row.id, {"state": following, "who": who, "why": why})
        _tell(row, following, who, why)
        return row

    def report_condition(self, identifier: str, stage: str, why: str, who: str = "acquisition") -> None:
        """Store a condition of a scan as its stage (for example a full disk), and append an event; the state stays."""
        with self.database.write() as session:
            row = self._find(session, identifier, lock=True)
            row.stage = stage[:120]
            data = {"state": row.state, "stage": row.stage, "who": who, "why": why}
            append_event(session, self.clock(), "scan", row.id, data)

    def report(self, identifier: str, stage: str, done: int, total: int) -> None:
        """Store the progress of a scan without changing its revision."""
        progress = update(ScanRow).where(ScanRow.id == identifier).values(stage=stage[:120], done=done, total=total)
        with self.database.write() as session:
            session.execute(progress)

    def label(self, identifier: str, labels: dict[str, str | None], revision: int | None = None) -> ScanRow:
        """Set labels of a scan, or remove those with value ``None``; with ``revision``, only if unchanged since.

        Raises
        ------
        Conflict
            Of the kind :class:`RevisionConflict` when it has.
        """
        with self.database.write() as session:
            row = self._find(session, identifier, lock=True)
            if revision is not None and row.revision != revision:
                raise RevisionConflict(f"scan {identifier} has changed since; read it again")
            row.labels = {name: text for name, text in (row.labels | labels).items() if text is not None}
        return row

    def set_desired_state(
        self,
        identifier: str,
        wish: DesiredScanState,
        reason: str | None,
        who: str = "local",
        revision: int | None = None,
        admit: Callable[[Session, ScanRow], int] | None = None,
    ) -> ScanRow:
        """Set the desired state of a scan; repeating it has no effect.

        Parameters
        ----------
        admit
            Asked in the same transaction when the scan is to fire again; returns the lease's number under which it
            does, or raises.

        Raises
        ------
        Conflict
            When the scan's state does not allow it, or it has changed since ``revision``.
        """
        with self.database.write() as session:
            if admit is not None and wish is DesiredScanState.RUNNING:  # the scanner first, as an emergency stop does
                session.execute(select(ScannerRow.id).order_by(ScannerRow.sequence).with_for_update())
            row = self._find(session, identifier, lock=True)
            if revision is not None and row.revision != revision:
                raise RevisionConflict(f"scan {identifier} has changed since; read it again")
            if row.desired_state is wish:
                return row
            possible = ALLOWED_DESIRED_STATES[row.state] & IRREVERSIBLE_DESIRED_STATES.get(
                row.desired_state, frozenset(DesiredScanState)
            )
            if wish not in possible:
                allowed = ", ".join(sorted(possible)) or "nothing; it has ended or is about to end"
                raise Conflict(f"scan {identifier} is {row.state} and cannot be {wish}; allowed: {allowed}")
            if admit is not None and wish is DesiredScanState.RUNNING:
                row.fence = admit(session, row)
            row.desired_state, row.reason, row.wished_by = wish, reason, who
            wished = {"state": row.state, "desired_state": wish, "who": who, "why": reason}
            append_event(session, self.clock(), "scan", row.id, wished)
        _tell(row, f"wished {wish}", who, reason)
        return row

    def interrupt_all(self, why: str) -> list[str]:
        """Set all active scans of the scanner to interrupted and return their identifiers."""
        active = [row.id for row in self.under_way() if row.scanner_id == self.scanner_id]
        return [self.transition(identifier, ScanState.INTERRUPTED, why=why).id for identifier in active]

    def _mine(self, state: ScanState) -> ColumnElement[bool]:
        return (ScanRow.scanner_id == self.scanner_id) & (ScanRow.state == state)


def _tell(row: ScanRow, what: str, who: str, why: str | None) -> None:
    """Write a log line about a scan's event, with the identifier of the current or original request."""
    with bind_request_id(request_id.get() or row.request_id):
        _log.info("scan %s is %s: %s (%s)", row.id, what, why or "no reason given", who)


class RevisionConflict(Conflict):
    """Error: the resource has changed since the caller read it."""

    code = "precondition-failed"
