"""Start-time fair queueing between the owners of jobs (API keys) within a priority level.

A job's turn is the start tag of start-time fair queueing (Goyal, Vin and Cheng, 1996) with jobs of equal length: one
more than the newest of whoever asked for it, but not before the first that waits. Each priority has turns of its own; a
job that is moved to another one keeps the turn that it has. One who asks alone is served in the order of asking; nobody
gains by not having asked for a while.
"""

from __future__ import annotations

from typing import Final

from sqlalchemy import exists, func, select
from sqlalchemy.orm import Session

from steradian.jobs.registry import LIVE_KINDS
from steradian.storage.db.database import advisory_xact_lock
from steradian.storage.db.tables import JobRow, ScanRow
from steradian.storage.repositories.event_log import EVENT_ORDER_LOCK
from steradian.storage.state_machines import ReconstructionState, ScanState

WAITS_FOR_SCAN: Final = JobRow.kind.in_(LIVE_KINDS) & exists().where(
    ScanRow.id == JobRow.scan_id, ScanRow.state == ScanState.QUEUED
)
QUEUE_ORDER: Final = (JobRow.priority, JobRow.turn, JobRow.sequence)
"""The order in which jobs that wait begin."""
TAG_LIMIT: Final = 1 << 21
"""How many there are; the engine's number of a place has 31 bits, of which the priority takes ten."""
_WAITING, _RUNNING = ReconstructionState.QUEUED, ReconstructionState.RUNNING


def next_start_tag(session: Session, owner: str, priority: int) -> int:
    """Return the fair-queueing start tag of an owner's next job, later than the owner's other tags.

    Nobody else takes one before this transaction ends. Jobs that follow a scan count with nobody: most are done where
    the scanner is, whatever else waits.
    """
    advisory_xact_lock(session, EVENT_ORDER_LOCK)
    turn, state = JobRow.turn, JobRow.state
    query = select(
        func.min(turn).filter(state == _WAITING),
        func.max(turn).filter(state == _RUNNING),
        func.max(turn).filter(JobRow.owner == owner),
    ).where(state.in_([_WAITING, _RUNNING]), JobRow.priority == priority, JobRow.kind.not_in(LIVE_KINDS))
    first, served, own = session.execute(query).one()
    now = next((turn for turn in (first, served) if turn is not None), 0)
    return min(TAG_LIMIT - 1, now if own is None else max(now, own + 1))


def queue_priority(row: JobRow) -> int:
    """Return the engine's numeric priority of a job, computed from priority and start tag; smaller runs first."""
    return row.priority * TAG_LIMIT + row.turn + 1
