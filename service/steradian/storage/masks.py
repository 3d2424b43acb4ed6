"""Masks in the database."""

from __future__ import annotations

from sqlalchemy import select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import undefer

from steradian.errors import NotFound
from steradian.masks import Mask
from steradian.storage.repository import Repository
from steradian.storage.tables import MaskRow


class MaskRepository(Repository[MaskRow]):
    """Masks, addressed by their content."""

    kind, table = "mask", MaskRow

    def put(self, mask: Mask) -> tuple[MaskRow, bool]:
        """Keep a mask; the flag says whether it is new."""
        row = MaskRow(
            id=mask.id,
            created=self.clock(),
            aperture=mask.aperture,
            depth=mask.depth,
            count=mask.count,
            weight_ratio=mask.weight_ratio,
            sensed_area=mask.sensed_area,
            arrangement=mask.arrangement,
            document=mask.model_dump_json(),
        )
        try:
            with self.database.write() as session:
                session.add(row)
            return row, True
        except IntegrityError:
            return self.get(mask.id), False

    def load(self, identifier: str) -> Mask:
        """Read the whole mask.

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
