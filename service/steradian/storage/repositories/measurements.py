"""Repository of the named measurements of reconstructions, a column of the job's row with a revision of its own."""

from __future__ import annotations

from typing import Any, TypeAlias

from sqlalchemy import select, update

from steradian.core.exceptions import NotFound
from steradian.storage.db.database import Database
from steradian.storage.db.tables import JobRow
from steradian.storage.repositories.scans import RevisionConflict

Items: TypeAlias = list[dict[str, Any]]


class MeasurementRepository:
    """Repository of named measurements, each a JSON object of definition and values."""

    def __init__(self, database: Database) -> None:
        self.database = database

    def get(self, reconstruction_id: str) -> tuple[int, Items]:
        """Return revision and measurements of a reconstruction; 0 and none before the first are stored."""
        with self.database.read() as session:
            found = session.scalar(select(JobRow.measurements).where(JobRow.id == reconstruction_id))
        return (0, []) if found is None else (found["revision"], found["items"])

    def put(self, reconstruction_id: str, items: Items, revision: int | None = None) -> int:
        """Replace the measurements of a reconstruction and return their revision.

        Raises
        ------
        NotFound
            When the reconstruction has been deleted.
        RevisionConflict
            When ``revision`` is given and not the stored one.
        """
        mine = JobRow.id == reconstruction_id
        with self.database.write() as session:
            row = session.execute(select(JobRow.id, JobRow.measurements).where(mine).with_for_update()).one_or_none()
            if row is None:
                raise NotFound("reconstruction", reconstruction_id)
            known = 0 if row.measurements is None else row.measurements["revision"]
            if revision is not None and known != revision:
                raise RevisionConflict(f"the measurements of {reconstruction_id} have changed since; read them again")
            stored = {"revision": known + 1, "items": items}
            session.execute(update(JobRow).where(mine).values(measurements=stored))
        return known + 1
