"""Scans in the database: the only place that changes their state."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from steradian.errors import Conflict, InvalidInput
from steradian.storage.repository import Repository, new_id
from steradian.storage.states import (
    ACTIVE_SCAN_STATES,
    DESIRABLE,
    DesiredScanState,
    ScanState,
    check_transition,
    is_terminal,
)
from steradian.storage.tables import IdempotencyRow, PlanRow, ScanRow

KEY_LIFETIME = timedelta(hours=24)


class ScanRepository(Repository[ScanRow]):
    """Scans, their states and their history."""

    kind, table = "scan", ScanRow

    def queue(
        self, plan: PlanRow, *, simulated: bool, key: str | None = None, body_hash: str = ""
    ) -> tuple[ScanRow, bool]:
        """Queue a run of a plan; the flag says whether it is new or the one that ``key`` made before.

        Raises
        ------
        InvalidInput
            When the key was used with another body.
        """
        now = self.clock()
        with self.database.write() as session:
            if key is not None and (earlier := self._earlier(session, key, body_hash)) is not None:
                return earlier, False
            row = ScanRow(
                id=new_id("s"),
                plan_id=plan.id,
                mask_id=plan.mask_id,
                simulated=simulated,
                state=ScanState.QUEUED,
                desired_state=DesiredScanState.RUNNING,
                created=now,
                summary=None,
                history=[{"state": ScanState.QUEUED, "at": now.isoformat(), "why": "requested"}],
            )
            session.add(row)
            if key is not None:
                session.add(IdempotencyRow(key=key, created=now, body_hash=body_hash, resource_id=row.id))
        return row, True

    def _earlier(self, session: Session, key: str, body_hash: str) -> ScanRow | None:
        kept = session.scalars(select(IdempotencyRow).where(IdempotencyRow.key == key)).one_or_none()
        if kept is None:
            return None
        if self.clock() - kept.created > KEY_LIFETIME:
            session.delete(kept)
            session.flush()
            return None
        if kept.body_hash != body_hash:
            raise InvalidInput("Idempotency-Key", key.partition(":")[2], "a key that was not used with another body")
        return self._find(session, kept.resource_id)

    def next_queued(self) -> ScanRow | None:
        """Return the oldest scan that waits for the scanner."""
        query = select(ScanRow).where(ScanRow.state == ScanState.QUEUED).order_by(ScanRow.sequence).limit(1)
        with self.database.read() as session:
            return session.scalars(query).one_or_none()

    def wished_settled(self) -> list[ScanRow]:
        """Return interrupted scans of which a person wants something other than to go on."""
        query = select(ScanRow).where(
            ScanRow.state == ScanState.INTERRUPTED, ScanRow.desired_state == DesiredScanState.STOPPED
        )
        with self.database.read() as session:
            return list(session.scalars(query))

    def transition(
        self,
        identifier: str,
        following: ScanState,
        *,
        why: str,
        error: tuple[str, str] | None = None,
        summary: dict[str, Any] | None = None,
    ) -> ScanRow:
        """Change a scan's state by the table and note it in the history.

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
            row = self._find(session, identifier)
            check_transition(identifier, row.state, following)
            row.state = following
            row.history = [*row.history, {"state": following, "at": now.isoformat(), "why": why}]
            if following is ScanState.RUNNING and row.started is None:
                row.started = now
            if is_terminal(following):
                row.ended = now
            if error is not None:
                row.error_code, row.error = error
            if summary is not None:
                row.summary = summary
        return row

    def report(self, identifier: str, stage: str, done: int, total: int) -> None:
        """Note how far a scan has come."""
        with self.database.write() as session:
            row = self._find(session, identifier)
            row.stage, row.done, row.total = stage[:120], done, total

    def desire(self, identifier: str, wish: DesiredScanState, reason: str | None) -> ScanRow:
        """Note what a person wants of a scan; wishing the same again changes nothing.

        Raises
        ------
        Conflict
            When the scan's state does not allow it.
        """
        with self.database.write() as session:
            row = self._find(session, identifier)
            if row.desired_state is wish:
                return row
            if wish not in DESIRABLE[row.state]:
                allowed = ", ".join(sorted(DESIRABLE[row.state])) or "nothing, it is over"
                raise Conflict(f"scan {identifier} is {row.state} and cannot be {wish}; allowed: {allowed}")
            row.desired_state, row.reason = wish, reason
        return row

    def interrupt_all(self, why: str) -> list[str]:
        """Mark every scan that a process should be at work on as interrupted; returns their identifiers."""
        with self.database.read() as session:
            found = list(session.scalars(select(ScanRow.id).where(ScanRow.state.in_(ACTIVE_SCAN_STATES))))
        for identifier in found:
            self.transition(identifier, ScanState.INTERRUPTED, why=why)
        return found
