"""Repositories of reconstructions and batches; their progress is in the job ledger."""

from __future__ import annotations

from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from steradian.storage.db.tables import BatchRow, ReconstructionRow, ScanRow
from steradian.storage.db.timestamps_and_ids import new_id
from steradian.storage.repositories.base import Repository
from steradian.storage.repositories.event_log import append_event
from steradian.storage.repositories.references import lock_row


class ReconstructionRepository(Repository[ReconstructionRow]):
    """Repository of reconstruction requests."""

    kind, table = "reconstruction", ReconstructionRow

    def add(
        self, session: Session, scan: ScanRow, parameters: dict[str, Any], batch: BatchRow | None = None
    ) -> ReconstructionRow:
        """Insert a reconstruction; raises :class:`NotFound` when the scan was deleted."""
        lock_row(session, "scan", scan.id)
        row = ReconstructionRow(
            id=new_id("r"),
            scan_id=scan.id,
            batch_id=None if batch is None else batch.id,
            simulated=scan.simulated,
            created=self.clock(),
            parameters=parameters,
        )
        session.add(row)
        return row

    def log_revision(self, identifier: str, scan_id: str, figures: dict[str, Any]) -> None:
        """Append an event about a new revision of a live reconstruction."""
        with self.database.write() as session:
            append_event(session, self.clock(), "revision", identifier, {"scan_id": scan_id, **figures})

    def of_batch(self, batch_id: str) -> list[ReconstructionRow]:
        """Return a batch's reconstructions in the order of their requests."""
        query = select(ReconstructionRow).where(ReconstructionRow.batch_id == batch_id)
        with self.database.read() as session:
            return list(session.scalars(query.order_by(ReconstructionRow.sequence)))


class BatchRepository(Repository[BatchRow]):
    """Repository of batches of reconstructions that were requested together."""

    kind, table = "batch", BatchRow

    def add(
        self, session: Session, scan: ScanRow, vary: dict[str, Any], parameters: dict[str, Any], who: str
    ) -> BatchRow:
        """Insert a batch; raises :class:`NotFound` when the scan was deleted."""
        lock_row(session, "scan", scan.id)
        row = BatchRow(id=new_id("b"), scan_id=scan.id, created=self.clock(), vary=vary, parameters=parameters)
        session.add(row)
        session.flush()
        append_event(session, row.created, "batch", row.id, {"state": "queued", "scan_id": scan.id, "who": who})
        return row
