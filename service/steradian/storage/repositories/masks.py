"""Repository of masks."""

from __future__ import annotations

from typing import Any

from sqlalchemy import select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import undefer

from steradian.core.exceptions import NotFound
from steradian.masks import Mask
from steradian.masks.modes_from_lattice import imported_modes
from steradian.storage.db.database import Database
from steradian.storage.db.tables import MaskRow
from steradian.storage.db.timestamps_and_ids import Clock, utc_now
from steradian.storage.repositories.base import Repository


class MaskRepository(Repository[MaskRow]):
    """Repository of masks, identified by a hash of their content."""

    kind, table = "mask", MaskRow

    def __init__(self, database: Database, clock: Clock = utc_now) -> None:
        super().__init__(database, clock)
        self._lines: dict[str, bool] = {}
        self._modes: dict[str, int | None] = {}

    def put(self, mask: Mask) -> tuple[MaskRow, bool]:
        """Store a mask and return its row and whether it is new."""
        return self.insert_row(mask_row_values(mask))

    def insert_row(self, columns: dict[str, Any]) -> tuple[MaskRow, bool]:
        """Insert the columns from :func:`mask_row_values` and return the row and whether it is new."""
        row = MaskRow(created=self.clock(), **columns)
        try:
            with self.database.write() as session:
                session.add(row)
            return row, True
        except IntegrityError:
            return self.get(row.id), False

    def load(self, identifier: str) -> Mask:
        """Return a mask, parsed from its stored document.

        Raises
        ------
        NotFound
            When there is none.
        """
        query = select(MaskRow).where(MaskRow.id == identifier).options(undefer(MaskRow.document))
        with self.database.read() as session:
            row = session.scalars(query).one_or_none()
        if row is None:
            raise NotFound(self.kind, identifier)
        return Mask.model_validate_json(row.document)

    def is_line(self, identifier: str) -> bool:
        """Return whether the sensors of a mask lie on a line (cached).

        Raises
        ------
        NotFound
            When there is none.
        """
        if identifier not in self._lines:
            self._lines[identifier] = self.load(identifier).is_line
        return self._lines[identifier]

    def default_modes(self, identifier: str) -> int | None:
        """Return the voxels per axis that follow from an imported grid (cached); raises :class:`NotFound`."""
        if identifier not in self._modes:
            mask = self.load(identifier)
            self._modes[identifier] = imported_modes(mask.positions, mask.aperture, mask.arrangement)
        return self._modes[identifier]


def mask_row_values(mask: Mask) -> dict[str, Any]:
    """Return the columns of a mask's row, except its creation time."""
    names = ("id", "aperture", "depth", "count", "weight_ratio", "sensed_area", "arrangement")
    return {name: getattr(mask, name) for name in names} | {"document": mask.model_dump_json()}
