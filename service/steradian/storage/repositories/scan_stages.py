"""Repository of the stages of scans, with their proposals and decisions.

The scan file is the truth about the stages that are made; the table repeats it, and has proposals and decisions that
are not in a file yet. A decision is taken once: by the person who asks first, or else by the rule of the stage.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import StrEnum
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from steradian.core.exceptions import Conflict, NotFound
from steradian.plans import ScanPlan
from steradian.plans.stages import Proposal, StageRecord
from steradian.storage.db.tables import PlanRow, ScannerRow, ScanRow
from steradian.storage.repositories.base import Repository
from steradian.storage.repositories.event_log import append_event
from steradian.storage.repositories.masks import MaskRepository
from steradian.storage.repositories.plans import PlanRepository
from steradian.storage.state_machines import ScanState, is_terminal

Points = Sequence[Sequence[float]]


class StageState(StrEnum):
    """States of a stage of a scan."""

    PLANNED = "planned"
    PROPOSED = "proposed"
    """There are proposals, and no decision yet: the laser is off."""
    DECIDED = "decided"
    MADE = "made"
    """Its points are in the scan file."""


def planned_stages(plan: PlanRow) -> list[dict[str, Any]] | None:
    """Return the stages of a scan that has not begun; ``None`` for a plan of one stage."""
    rules = plan.parameters.get("stages") or ()
    if not rules:
        return None
    first = {"number": 1, "state": StageState.MADE, "points": None, "plan_id": plan.id, "mask_id": plan.mask_id}
    return [first, *(_planned(number, rule) for number, rule in enumerate(rules, start=2))]


def has_further_stages(row: ScanRow) -> bool:
    """Return whether a scan has stages whose points are not in its file yet."""
    return any(stage["state"] != StageState.MADE for stage in row.stages or ())


def _planned(number: int, rule: dict[str, Any]) -> dict[str, Any]:
    known = rule["points_of_interest"]
    return {
        "number": number,
        "state": StageState.DECIDED if known else StageState.PLANNED,
        "points": rule["points"],
        "decision": rule["decision"],
        "points_of_interest": known,
        "decided_by": "plan" if known else "",
        "proposals": [],
    }


class ScanStageRepository(Repository[ScanRow]):
    """Repository of the stages of scans."""

    kind, table = "scan", ScanRow

    def set_made(self, identifier: str, records: Sequence[StageRecord], plan: ScanPlan) -> None:
        """Store the stages that a scan file has, and the plan of all of them with its mask."""
        if not records:
            return
        MaskRepository(self.database, self.clock).put(plan.mask)
        row, _ = PlanRepository(self.database, self.clock).put(plan)
        with self.database.write() as session:
            scan = self._find(session, identifier, lock=True)
            if scan.measured_plan_id == row.id or scan.stages is None:
                return
            made = [record.model_dump(mode="json") | {"state": StageState.MADE} for record in records]
            made[0] |= {"mask_id": scan.stages[0]["mask_id"]}
            made[-1] |= {"mask_id": row.mask_id}
            stages = [before | now for before, now in zip(scan.stages, made, strict=False)]
            scan.stages = [*stages, *scan.stages[len(made) :]]
            scan.measured_plan_id, scan.mask_id = row.id, row.mask_id
            self._tell(session, scan, len(made))

    def propose(self, identifier: str, number: int, proposals: Sequence[Proposal]) -> None:
        """Store the proposals for the points of interest of a stage that is not decided yet."""
        with self.database.write() as session:
            scan = self._find(session, identifier, lock=True)
            stage = _stage(scan, number)
            if stage["state"] in (StageState.DECIDED, StageState.MADE):
                return
            found = [proposal.model_dump(mode="json") for proposal in proposals]
            self._change(session, scan, number, {"state": StageState.PROPOSED, "proposals": found})

    def decide_by_rule(self, identifier: str, number: int, points: Points) -> None:
        """Store the decision of a stage's rule, unless a person has decided before."""
        with self.database.write() as session:
            scan = self._find(session, identifier, lock=True)
            if _stage(scan, number)["state"] not in (StageState.DECIDED, StageState.MADE):
                self._change(session, scan, number, _decision(points, "auto"))

    def decide(
        self, identifier: str, number: int, points: Points, who: str, admit: Callable[[Session, ScanRow], object]
    ) -> ScanRow:
        """Store a person's decision on the points of interest of a stage; repeating it has no effect.

        Parameters
        ----------
        identifier, number
            Scan and stage.
        points
            (P, 3) x, y and depth in m.
        who
            Principal who decides.
        admit
            Asked in the same transaction; raises where the principal may not let the laser fire.

        Raises
        ------
        NotFound
            When the scan has no such stage.
        Conflict
            When the stage is decided otherwise or made already, or the scan has ended.
        """
        with self.database.write() as session:
            session.execute(select(ScannerRow.id).order_by(ScannerRow.sequence).with_for_update())
            scan = self._find(session, identifier, lock=True)
            stage = _stage(scan, number)
            wanted = _decision(points, who)
            if stage["state"] in (StageState.DECIDED, StageState.MADE):
                if stage["points_of_interest"] == wanted["points_of_interest"]:
                    return scan
                if stage["state"] == StageState.MADE or scan.state is not ScanState.INTERRUPTED:
                    raise Conflict(f"stage {number} of scan {identifier} is {stage['state']} by {stage['decided_by']}")
            if is_terminal(scan.state):
                raise Conflict(f"scan {identifier} is {scan.state}; nothing more is measured")
            admit(session, scan)
            self._change(session, scan, number, wanted)
            return scan

    def _change(self, session: Session, scan: ScanRow, number: int, changes: dict[str, Any]) -> None:
        stages = scan.stages or []
        scan.stages = [stage | changes if stage["number"] == number else stage for stage in stages]
        self._tell(session, scan, number)

    def _tell(self, session: Session, scan: ScanRow, number: int) -> None:
        stage = _stage(scan, number)
        named = {"number": number, "state": stage["state"], "points_of_interest": stage.get("points_of_interest") or []}
        data = {"state": scan.state, "stage": scan.stage, "scan_stage": named, "who": stage.get("decided_by") or ""}
        append_event(session, self.clock(), "scan", scan.id, data | {"why": f"stage {number} is {stage['state']}"})


def _stage(scan: ScanRow, number: int) -> dict[str, Any]:
    for stage in scan.stages or ():
        if stage["number"] == number:
            return stage
    raise NotFound(f"stage of scan {scan.id}", str(number))


def _decision(points: Points, who: str) -> dict[str, Any]:
    places = [[float(value) for value in point] for point in points]
    return {"state": StageState.DECIDED, "points_of_interest": places, "decided_by": who}
