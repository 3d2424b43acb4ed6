"""Repository of scan plans."""

from __future__ import annotations

from dataclasses import asdict
from functools import cache
from typing import Any

from pydantic import TypeAdapter
from sqlalchemy.exc import IntegrityError

from steradian.plans import ScanPlan, preview_excitation
from steradian.plans.preview import PlanCost, preview
from steradian.storage.db.tables import PlanRow
from steradian.storage.repositories.base import Repository
from steradian.storage.repositories.masks import MaskRepository
from steradian.storage.repositories.references import lock_row


def plan_cost_document(plan: ScanPlan) -> dict[str, Any]:
    """Return a plan's cost (time, shots, bytes) and wavelengths' expected error as JSON-compatible values."""
    document: dict[str, Any] = _preview_adapter().dump_python(preview(plan), mode="json")
    if len(plan.excitation) > 1:
        document["oxygenation"] = asdict(preview_excitation(plan))
    return document


@cache
def _preview_adapter() -> TypeAdapter[PlanCost]:
    return TypeAdapter(PlanCost)  # once, as that takes longer than all else


class PlanRepository(Repository[PlanRow]):
    """Repository of scan plans, identified by a hash of their content."""

    kind, table = "plan", PlanRow

    def put(self, plan: ScanPlan) -> tuple[PlanRow, bool]:
        """Store a plan and return its row and whether it is new; raises :class:`NotFound` without the mask."""
        return self.put_columns(to_columns(plan))

    def put_columns(self, columns: dict[str, Any]) -> tuple[PlanRow, bool]:
        """Insert the columns from :func:`to_columns` and return the row and whether it is new."""
        row = PlanRow(created=self.clock(), **columns)
        try:
            with self.database.write() as session:
                lock_row(session, "mask", row.mask_id)
                session.add(row)
            return row, True
        except IntegrityError:
            return self.get(row.id), False

    def load(self, identifier: str) -> ScanPlan:
        """Return a plan with its mask.

        Raises
        ------
        NotFound
            When there is none.
        """
        row = self.get(identifier)
        mask = MaskRepository(self.database, self.clock).load(row.mask_id)
        return ScanPlan.create(mask=mask, **row.parameters)


def to_columns(plan: ScanPlan) -> dict[str, Any]:
    """Return the columns of a plan's row, except its creation time."""
    parameters = plan.model_dump(mode="json", exclude={"mask"})
    return {"id": plan.id, "mask_id": plan.mask.id, "parameters": parameters, "preview": plan_cost_document(plan)}
