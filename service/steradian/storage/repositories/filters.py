"""SQL WHERE clauses for the filters of the list endpoints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

from sqlalchemy import ColumnElement, and_, exists, or_, select
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.compiler import SQLCompiler
from sqlalchemy.sql.functions import GenericFunction

from steradian.storage.db.tables import BatchRow, JobRow, MaskRow, PlanRow, ScanRow
from steradian.storage.state_machines import BatchState, ReconstructionState, is_terminal

WhereClauses: TypeAlias = list[ColumnElement[bool]]
Label: TypeAlias = tuple[str, str | None]
"""A name, and its text if that matters."""
_R = ReconstructionState


class _JsonMembers(GenericFunction[Any]):
    """SQL function that returns the members of a JSON object as rows of key and value."""

    name = "json_each"
    inherit_cache = True


@compiles(_JsonMembers, "postgresql")
def _as_text(element: _JsonMembers, compiler: SQLCompiler, **options: Any) -> str:
    return f"json_each_text{compiler.function_argspec(element, **options)}"


def masks(*, arrangement: str | None = None) -> WhereClauses:
    """Return the WHERE clauses that select masks by arrangement."""
    return _equal((MaskRow.arrangement["arrangement"].as_string(), arrangement))


def plans(*, mask_id: str | None = None) -> WhereClauses:
    """Return the WHERE clauses that select plans by mask."""
    return _equal((PlanRow.mask_id, mask_id))


def scans(
    *,
    state: Sequence[str] | None = None,
    label: Sequence[Label] | None = None,
    plan_id: str | None = None,
    mask_id: str | None = None,
) -> WhereClauses:
    """Return the WHERE clauses that select scans by state, labels, plan and mask."""
    found = _equal((ScanRow.plan_id, plan_id), (ScanRow.mask_id, mask_id))
    found += [] if state is None else [ScanRow.state.in_(state)]
    return found + [_has_label(*one) for one in label or ()]


def jobs(
    *,
    state: Sequence[str] | None = None,
    kind: str | None = None,
    scan_id: str | None = None,
    batch_id: str | None = None,
    reconstruction_id: str | None = None,
) -> WhereClauses:
    """Return the WHERE clauses that select jobs by state, kind, scan, batch and reconstruction."""
    about = JobRow.payload["reconstruction_id"].as_string()
    found = _equal(
        (JobRow.kind, kind), (JobRow.scan_id, scan_id), (JobRow.batch_id, batch_id), (about, reconstruction_id)
    )
    return found + ([] if state is None else [JobRow.state.in_(state)])


def reconstructions(
    *,
    state: Sequence[str] | None = None,
    kind: str | None = None,
    scan_id: str | None = None,
    batch_id: str | None = None,
    mask_id: str | None = None,
) -> WhereClauses:
    """Return the WHERE clauses that select reconstructions by state, kind, scan, batch or mask."""
    found = [JobRow.resource == "reconstruction", *jobs(state=state, kind=kind, scan_id=scan_id, batch_id=batch_id)]
    if mask_id is not None:
        measured = JobRow.scan_id.in_(select(ScanRow.id).where(ScanRow.mask_id == mask_id))
        found.append(or_(measured, JobRow.payload[("through", "mask_id")].as_string() == mask_id))
    return found


def batches(*, state: Sequence[str] | None = None, scan_id: str | None = None) -> WhereClauses:
    """Return the WHERE clauses that select batches by state and scan."""
    found = _equal((BatchRow.scan_id, scan_id))
    return found if state is None else [*found, or_(*(_batch_state(BatchState(one)) for one in state))]


def _batch_state(state: BatchState) -> ColumnElement[bool]:
    """Return the SQL condition that selects batches in a state, from the states of their jobs."""

    def some(*states: ReconstructionState) -> ColumnElement[bool]:
        return exists().where(JobRow.batch_id == BatchRow.id, JobRow.state.in_(states))

    over = ~some(*(one for one in _R if not is_terminal(one)))
    match state:
        case BatchState.QUEUED:
            return and_(some(_R.QUEUED), ~some(*set(_R) - {_R.QUEUED}))
        case BatchState.RUNNING:
            return and_(~over, some(*set(_R) - {_R.QUEUED}))
        case BatchState.FAILED:
            return and_(over, some(_R.FAILED))
        case BatchState.CANCELLED:
            return and_(over, some(_R.CANCELLED), ~some(_R.FAILED))
        case BatchState.SUCCEEDED:
            return and_(some(_R.SUCCEEDED), ~some(*set(_R) - {_R.SUCCEEDED}))
        case BatchState.FORGOTTEN:
            return ~some(*_R)


def _has_label(name: str, text: str | None) -> ColumnElement[bool]:
    member = _JsonMembers(ScanRow.labels).table_valued("key", "value").alias()
    wanted = [member.c.key == name, *([] if text is None else [member.c.value == text])]
    return select(1).select_from(member).where(*wanted).correlate(ScanRow).exists()


def _equal(*pairs: tuple[Any, str | None]) -> WhereClauses:
    return [column == value for column, value in pairs if value is not None]
