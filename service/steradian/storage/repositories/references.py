"""Dependencies between resources, and the row locks that protect referenced rows from deletion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

from sqlalchemy import or_, select
from sqlalchemy.orm import Session

from steradian.core.exceptions import NotFound
from steradian.storage.db.tables import BatchRow, JobRow, MaskRow, PlanRow, ScanRow

RowType: TypeAlias = type[MaskRow] | type[PlanRow] | type[ScanRow] | type[BatchRow] | type[JobRow]
DELETION_ORDER: Final[dict[str, RowType]] = {
    "mask": MaskRow,
    "plan": PlanRow,
    "scan": ScanRow,
    "batch": BatchRow,
    "reconstruction": JobRow,
    "job": JobRow,
}
"""What can be deleted, in the order of dependence: each of a kind may depend on those before it."""
REFERENCE_FIELDS: Final = {"scan_id": "scan", "reconstruction_id": "reconstruction", "reference_id": "reconstruction"}
"""What a job's request names, as which kind of thing."""


@dataclass(frozen=True)
class Resource:
    """Kind and identifier of a resource."""

    kind: str
    id: str


def lock_row(session: Session, kind: str, identifier: str) -> None:
    """Lock a resource's row against deletion until the transaction ends, so that a dependent can be inserted.

    Raises
    ------
    NotFound
        When it is gone, deleted just now perhaps.
    """
    table = DELETION_ORDER[kind]
    query = select(table.id).where(table.id == identifier)
    if session.scalar(query.with_for_update(read=True, key_share=True)) is None:
        raise NotFound(kind, identifier)


def lock_references(session: Session, *requests: Mapping[str, Any]) -> None:
    """Lock the rows of all resources that job requests reference, in the order of deletions.

    Rows are locked before any other lock or event, in the order masks, scans, reconstructions, event log, to prevent
    deadlocks.
    """
    through = [request["through"]["mask_id"] for request in requests if request.get("through") is not None]
    for mask in sorted(set(through)):
        lock_row(session, "mask", mask)
    for kind in ("scan", "reconstruction"):
        names = [name for name, read in REFERENCE_FIELDS.items() if read == kind]
        asked = {request[name] for request in requests for name in names if request.get(name) is not None}
        for identifier in sorted(asked):
            lock_row(session, kind, identifier)


def referenced_jobs(session: Session) -> set[str]:
    """Return the reconstructions that unfinished jobs have to read."""
    names = [JobRow.payload[name].as_string() for name, kind in REFERENCE_FIELDS.items() if kind == "reconstruction"]
    found = session.execute(select(*names).where(JobRow.ended.is_(None)))
    return {identifier for row in found for identifier in row if identifier is not None}


def lock_dependents(session: Session, first: Resource) -> list[Resource]:
    """Return a resource and all its dependents, with rows locked until the transaction ends.

    Rows are locked kind by kind, sorted by identifier, to prevent deadlocks of concurrent deletions.

    Raises
    ------
    NotFound
        When it was deleted just now.
    """
    found = {first: None}
    for kind, table in DELETION_ORDER.items():
        done: set[Resource] = set()
        while those := [one for one in found if one.kind == kind and one not in done]:  # an unmixing depends on one
            done.update(those)
            holding = select(table.id).where(table.id.in_([one.id for one in those])).order_by(table.id)
            held = set(session.scalars(holding.with_for_update()))
            for one in those:
                if one.id in held:
                    found |= dict.fromkeys(_dependents(session, one))
                else:  # another deletion was first
                    del found[one]
    if first not in found:
        raise NotFound(first.kind, first.id)
    return list(found)


def _dependents(session: Session, of: Resource) -> list[Resource]:
    asked = JobRow.payload
    match of.kind:
        case "mask":
            plans = session.scalars(select(PlanRow.id).where(PlanRow.mask_id == of.id))
            through = asked["through", "mask_id"].as_string() == of.id
            return [*(Resource("plan", plan) for plan in plans), *jobs(session, through)]
        case "plan":
            measured = or_(ScanRow.plan_id == of.id, ScanRow.measured_plan_id == of.id)
            return [Resource("scan", scan) for scan in session.scalars(select(ScanRow.id).where(measured))]
        case "scan":
            batches = session.scalars(select(BatchRow.id).where(BatchRow.scan_id == of.id))
            work = jobs(session, JobRow.scan_id == of.id)
            return [*work, *(Resource("batch", batch) for batch in batches)]
        case "batch":
            return jobs(session, JobRow.batch_id == of.id)
        case "reconstruction":
            names = ("reconstruction_id", "reference_id")
            return jobs(session, or_(*(asked[name].as_string() == of.id for name in names)))
    return []


def jobs(session: Session, condition: Any) -> list[Resource]:
    """Return references to the jobs that match a condition, as reconstruction or job."""
    rows = session.execute(select(JobRow.resource, JobRow.id).where(condition).order_by(JobRow.sequence))
    return [Resource(kind, job) for kind, job in rows]
