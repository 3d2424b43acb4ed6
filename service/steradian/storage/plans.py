"""Plans in the database."""

from __future__ import annotations

from dataclasses import asdict

from sqlalchemy.exc import IntegrityError

from steradian.plans import ScanPlan, preview
from steradian.storage.masks import MaskRepository
from steradian.storage.repository import Repository
from steradian.storage.tables import PlanRow


class PlanRepository(Repository[PlanRow]):
    """Plans, addressed by their content."""

    kind, table = "plan", PlanRow

    def put(self, plan: ScanPlan) -> tuple[PlanRow, bool]:
        """Keep a plan whose mask is kept already; the flag says whether it is new."""
        cost = asdict(preview(plan))
        row = PlanRow(
            id=plan.id,
            mask_id=plan.mask.id,
            created=self.clock(),
            parameters=plan.model_dump(mode="json", exclude={"mask"}),
            preview=cost | {"findings": list(cost["findings"])},
        )
        try:
            with self.database.write() as session:
                session.add(row)
            return row, True
        except IntegrityError:
            return self.get(plan.id), False

    def load(self, identifier: str) -> ScanPlan:
        """Read the whole plan with its mask.

        Raises
        ------
        NotFound
            When there is none.
        """
        row = self.get(identifier)
        mask = MaskRepository(self.database, self.clock).load(row.mask_id)
        return ScanPlan.create(mask=mask, **row.parameters)
