"""Event log: every change of state in order, written in the transaction of the change.

On PostgreSQL a transaction takes a lock before it writes an event, so that events become visible in the order of
their numbers and a reader that has seen number n never misses a smaller one. SQLite has one writer anyway.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import delete, func, select
from sqlalchemy.orm import Session

from steradian.storage.db.database import Database, advisory_xact_lock
from steradian.storage.db.tables import EventRow, FactRow

EVENT_ORDER_LOCK = 0x57E2AD1A
"""Number of the PostgreSQL advisory lock under which events are written."""


def append_event(session: Session, at: datetime, kind: str, resource_id: str, data: dict[str, Any]) -> None:
    """Append an event to the log in the caller's transaction.

    Parameters
    ----------
    kind
        ``scan``, ``reconstruction``, ``revision``, ``job``, ``batch`` or ``scanner``.
    data
        What changed, plain JSON; its ``scan_id`` is what streams are filtered by.
    """
    advisory_xact_lock(session, EVENT_ORDER_LOCK)
    scan_id = resource_id if kind == "scan" else data.get("scan_id")
    session.add(EventRow(at=at, kind=kind, resource_id=resource_id, scan_id=scan_id, data=data))


@dataclass(frozen=True)
class LogBounds:
    """Bounds of the event log: its epoch, the number before its first event, and the number of its last event."""

    epoch: str
    before: int
    last: int


class EventLog:
    """Reader of the event log, which also prunes old events."""

    def __init__(self, database: Database) -> None:
        self.database = database

    def bounds(self) -> LogBounds:
        """Return the bounds of the event log."""
        with self.database.read() as session:
            facts = {row.name: row.value for row in session.scalars(select(FactRow))}
            last = session.scalar(select(func.max(EventRow.sequence)))
        before = int(facts.get("pruned", 0))
        return LogBounds(facts["epoch"], before, max(before, last or 0))

    def after(self, sequence: int, limit: int) -> list[EventRow]:
        """Return at most ``limit`` events after a sequence number, oldest first."""
        query = select(EventRow).where(EventRow.sequence > sequence).order_by(EventRow.sequence).limit(limit)
        with self.database.read() as session:
            return list(session.scalars(query))

    def prune(self, older_than: datetime) -> int:
        """Delete events older than a time and return their number."""
        with self.database.write() as session:
            newest = session.scalar(select(func.max(EventRow.sequence)).where(EventRow.at < older_than))
            if newest is None:
                return 0
            gone = session.execute(delete(EventRow).where(EventRow.sequence <= newest))
            session.merge(FactRow(name="pruned", value=str(newest)))
            return int(gone.rowcount)  # type: ignore[attr-defined]
