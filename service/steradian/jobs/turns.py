"""Whose turn it is: among jobs of equal priority, those who asked take turns, however many jobs each has queued.

A job's turn is the start tag of start-time fair queueing (Goyal, Vin and Cheng, 1996) with jobs of equal length: one
more than the newest of whoever asked for it, but not before the turn that is served now. It stays for as long as the
job waits, also when its priority is changed. One who asks alone is served in the order of asking; nobody gains by not
having asked for a while.
"""

from __future__ import annotations

from typing import Final

from sqlalchemy import exists, func, select
from sqlalchemy.orm import Session

from steradian.jobs.kinds import FOLLOWING
from steradian.storage.states import ReconstructionState, ScanState
from steradian.storage.tables import JobRow, ScanRow

WAITS_FOR_SCAN: Final = JobRow.kind.in_(FOLLOWING) & exists().where(
    ScanRow.id == JobRow.scan_id, ScanRow.state == ScanState.QUEUED
)
ORDER: Final = (JobRow.priority, JobRow.turn, JobRow.sequence)
"""The order in which jobs that wait begin."""
TURNS: Final = 1 << 21
"""How many there are; the engine's number of a place has 31 bits, of which the priority takes ten."""
_WAITING, _RUNNING = ReconstructionState.QUEUED, ReconstructionState.RUNNING


def next_turn(session: Session, owner: str) -> int:
    """Tell the turn of one more job that somebody asks for; it is later than that of any other of theirs."""
    turn, state = JobRow.turn, JobRow.state
    query = select(
        func.max(turn).filter(state == _RUNNING),
        func.min(turn).filter(state == _WAITING, ~WAITS_FOR_SCAN),
        func.max(turn).filter(JobRow.owner == owner),
    ).where(state.in_([_WAITING, _RUNNING]))
    served, first, own = session.execute(query).one()
    now = next((turn for turn in (served, first) if turn is not None), 0)
    return min(TURNS - 1, now if own is None else max(now, own + 1))


def place(row: JobRow) -> int:
    """Tell a job's place as the engine counts: from 1, smaller ones first, equal ones by age."""
    return row.priority * TURNS + row.turn + 1
