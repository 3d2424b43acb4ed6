"""Base class of the repositories, with lookup by identifier and keyset pagination."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from sqlalchemy import select
from sqlalchemy.orm import Session

from steradian.core.exceptions import NotFound
from steradian.storage.db.database import Database
from steradian.storage.db.tables import BatchRow, JobRow, MaskRow, PlanRow, ScannerRow, ScanRow
from steradian.storage.db.timestamps_and_ids import Clock, utc_now
from steradian.storage.repositories.filters import WhereClauses

Row = TypeVar("Row", MaskRow, PlanRow, ScanRow, JobRow, BatchRow, ScannerRow)


@dataclass(frozen=True)
class Page(Generic[Row]):
    """Page of a list, newest first, with the cursor of the next page (``None`` at the end)."""

    rows: list[Row]
    cursor: int | None


class Repository(Generic[Row]):
    """Base class of repositories: read access to the rows of one table."""

    kind: str
    table: type[Row]

    def __init__(self, database: Database, clock: Clock = utc_now) -> None:
        self.database, self.clock = database, clock

    def get(self, identifier: str) -> Row:
        """Return the row with an identifier.

        Raises
        ------
        NotFound
            When there is none.
        """
        with self.database.read() as session:
            return self._find(session, identifier)

    def page(self, limit: int, before: int | None = None, where: WhereClauses | None = None) -> Page[Row]:
        """Return a page of at most ``limit`` rows, newest first, before the sequence number ``before``.

        Parameters
        ----------
        where
            Which rows only; see :mod:`steradian.storage.repositories.filters`.
        """
        query = select(self.table).where(*where or ()).order_by(self.table.sequence.desc()).limit(limit + 1)
        if before is not None:
            query = query.where(self.table.sequence < before)
        with self.database.read() as session:
            rows = list(session.scalars(query))
        return Page(rows[:limit], rows[limit - 1].sequence if len(rows) > limit else None)

    def _find(self, session: Session, identifier: str, *, lock: bool = False) -> Row:
        """Return the row with an identifier, with ``lock`` locked until the transaction ends."""
        query = select(self.table).where(self.table.id == identifier)
        row = session.scalars(query.with_for_update() if lock else query).one_or_none()
        if row is None:
            raise NotFound(self.kind, identifier)
        return row
