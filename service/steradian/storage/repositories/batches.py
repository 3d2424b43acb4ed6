"""Repository of batches; the progress of their jobs is in the job ledger."""

from __future__ import annotations

from typing import Any

from sqlalchemy.orm import Session

from steradian.storage.db.tables import BatchRow, ScanRow
from steradian.storage.db.timestamps_and_ids import new_id
from steradian.storage.repositories.base import Repository
from steradian.storage.repositories.event_log import append_event
from steradian.storage.repositories.references import lock_row


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
