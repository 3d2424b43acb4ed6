"""Registration of imported scans in the database (idempotent)."""

from __future__ import annotations

from typing import Any

from sqlalchemy import select

from steradian.core.logging_config import request_id
from steradian.plans import ScanPlan
from steradian.storage.db.database import Database
from steradian.storage.db.tables import ScanRow
from steradian.storage.db.timestamps_and_ids import Clock, utc_now
from steradian.storage.repositories.event_log import append_event
from steradian.storage.repositories.masks import MaskRepository
from steradian.storage.repositories.plans import PlanRepository
from steradian.storage.state_machines import DesiredScanState, ScanState


def register_import(
    database: Database,
    plan: ScanPlan,
    scan_id: str,
    *,
    simulated: bool,
    summary: dict[str, Any],
    labels: dict[str, str],
    who: str,
    clock: Clock = utc_now,
) -> None:
    """Insert the rows of an imported scan, its plan and its mask (idempotent).

    Parameters
    ----------
    plan
        With its mask, as the file says; both are kept too.
    summary
        Counts of the scan: ``points`` planned and ``stored``, at least.
    who
        The principal who asked for it.
    """
    MaskRepository(database, clock).put(plan.mask)
    row, _ = PlanRepository(database, clock).put(plan)
    now = clock()
    why = "imported"
    state = ScanState.COMPLETE if summary["stored"] == summary["points"] else ScanState.PARTIAL
    with database.write() as session:
        if session.scalars(select(ScanRow).where(ScanRow.id == scan_id)).one_or_none() is not None:
            return
        scan = ScanRow(
            id=scan_id,
            plan_id=row.id,
            mask_id=row.mask_id,
            request_id=request_id.get() or None,
            simulated=simulated,
            labels=labels,
            fence=0,
            state=state,
            desired_state=DesiredScanState.RUNNING,
            created=now,
            ended=now,
            stage=why,
            done=summary["stored"],
            total=summary["points"],
            summary=summary,
            history=[{"state": state, "at": now.isoformat(), "who": who, "why": why}],
        )
        session.add(scan)
        append_event(session, now, "scan", scan_id, {"state": state, "who": who, "why": why})


def imported_scan_id(job_id: str) -> str:
    """Return the identifier of the scan that an import job creates; the same for each attempt."""
    return f"s{job_id[1:]}"


def importing_job_id(scan_id: str) -> str:
    """Return the identifier of the import job that creates a scan with this identifier."""
    return f"j{scan_id[1:]}"
