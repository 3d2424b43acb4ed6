"""Reconstructions in the database: what was asked; the queue knows how far it came."""

from __future__ import annotations

from typing import Any

from sqlalchemy import select

from steradian.storage.repository import Repository, new_id
from steradian.storage.tables import ReconstructionRow, ScanRow


class ReconstructionRepository(Repository[ReconstructionRow]):
    """Reconstructions and whether the queue has them."""

    kind, table = "reconstruction", ReconstructionRow

    def add(self, scan: ScanRow, parameters: dict[str, Any]) -> ReconstructionRow:
        """Note a reconstruction that the queue does not have yet."""
        row = ReconstructionRow(
            id=new_id("r"),
            scan_id=scan.id,
            simulated=scan.simulated,
            created=self.clock(),
            parameters=parameters,
            cancel_wanted=False,
            submitted=False,
        )
        with self.database.write() as session:
            session.add(row)
        return row

    def mark_submitted(self, identifier: str) -> None:
        """Note that the queue has it."""
        with self.database.write() as session:
            self._find(session, identifier).submitted = True

    def unsubmitted(self) -> list[ReconstructionRow]:
        """Return those that a crash kept from reaching the queue, oldest first."""
        query = select(ReconstructionRow).where(ReconstructionRow.submitted.is_(False))
        with self.database.read() as session:
            return list(session.scalars(query.order_by(ReconstructionRow.sequence)))

    def want_cancelled(self, identifier: str, reason: str | None) -> ReconstructionRow:
        """Note that a person wants it cancelled, and why."""
        with self.database.write() as session:
            row = self._find(session, identifier)
            row.cancel_wanted, row.cancel_reason = True, reason
        return row
