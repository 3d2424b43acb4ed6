"""Queue position and estimated completion time of waiting jobs."""

from __future__ import annotations

import heapq
import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from statistics import fmean, median
from typing import Any, Final

from sqlalchemy import ColumnElement, func, or_, select, tuple_
from sqlalchemy.orm import Session

from steradian.jobs.job import requirements_of
from steradian.jobs.queue import matching as capabilities
from steradian.jobs.queue.fair_queueing import QUEUE_ORDER, WAITS_FOR_SCAN
from steradian.jobs.registry import LIVE_KINDS
from steradian.storage.db.tables import JobRow
from steradian.storage.state_machines import ReconstructionState

HISTORY, MIN_SAMPLES = 50, 3
"""Newest jobs of a kind that are looked at, and how many of a sort tell how long one takes."""
MAX_JOBS: Final = 200
"""Place in the queue beyond which nothing is said about the end."""
_R = ReconstructionState
_METHOD, _FORMAT = JobRow.payload["parameters"]["method"].as_string(), JobRow.payload["format"].as_string()
_SORT: Final = (JobRow.kind, _METHOD, _FORMAT, JobRow.promised)
"""What tells which jobs take about as long, read without the rest of hundreds of rows."""


@dataclass(frozen=True)
class QueueEstimate:
    """Estimate for a queued or running job: position in the queue and expected end.

    Attributes
    ----------
    position
        1 for the next that begins; ``None`` when it runs, or waits for its scan or for another worker.
    expected_end
        ``None`` when it cannot be said: too few such jobs have been done, no worker is busy, or one takes longer than
        it should.
    awaited
        The worker that it waits for, in words, where none that is present can do it.
    """

    position: int | None = None
    expected_end: datetime | None = None
    awaited: str | None = None


def forecast(session: Session, job_id: str, workers: int, now: datetime) -> QueueEstimate | None:
    """Return the queue position and expected end of a job; ``None`` if the job has ended or was deleted.

    Parameters
    ----------
    workers
        How many jobs run at a time.
    """
    row = session.scalar(select(JobRow).where(JobRow.id == job_id))
    if row is None or row.state not in {_R.QUEUED, _R.RUNNING}:
        return None
    pace = _DurationModel(session)
    if row.state is _R.RUNNING:
        return QueueEstimate(None, _in_future(pace.end_of(row), now))
    waiting = [JobRow.state == _R.QUEUED, ~WAITS_FOR_SCAN]
    if session.scalar(select(JobRow.id).where(JobRow.id == job_id, *waiting)) is None:
        return QueueEstimate()
    present = capabilities.present_workers(session, now)
    own = capabilities.dedicated_scanner(session, row.kind, row.scan_id)
    if said := capabilities.missing_capability(own, requirements_of(row), present):
        return QueueEstimate(awaited=said)
    waiting += _skipped(present)
    earlier = [*waiting, tuple_(*QUEUE_ORDER) < (row.priority, row.turn, row.sequence)]
    ahead = session.scalar(select(func.count()).select_from(JobRow).where(*earlier)) or 0
    if ahead >= MAX_JOBS:
        return QueueEstimate(ahead + 1)
    running = session.scalars(select(JobRow).where(JobRow.state == _R.RUNNING)).all()
    ends = [_in_future(pace.end_of(one), now) for one in running]
    before = session.execute(select(*_SORT).where(*earlier).order_by(*QUEUE_ORDER)).all()
    lasting = [*(pace.of(*one) for one in before), pace.seconds(row)]
    known, taking = [end for end in ends if end], [seconds for seconds in lasting if seconds is not None]
    if not workers or len(known) < workers or len(known) < len(ends) or len(taking) < len(lasting):
        return QueueEstimate(ahead + 1)
    return QueueEstimate(ahead + 1, _last_end(known, taking))


@dataclass(frozen=True)
class Backlog:
    """Backlog of the queue, for autoscaling of workers: seconds of queued work and age of the oldest job.

    Attributes
    ----------
    seconds
        How long one worker would take for all of it, extrapolated from the first that wait; jobs of a sort of which too
        few have been done count as the mean of the others. ``None`` where nothing can be said of any.
    oldest
        Seconds since the oldest job that waits was asked for; 0 when none waits.
    """

    seconds: float | None
    oldest: float


def backlog(session: Session, now: datetime, present: Mapping[str, capabilities.Capabilities]) -> Backlog:
    """Estimate the seconds of queued work for the present workers, and the age of the oldest queued job."""
    waits = [JobRow.state == _R.QUEUED, ~WAITS_FOR_SCAN, *_skipped(present)]
    count, oldest = session.execute(select(func.count(), func.min(JobRow.created)).where(*waits)).one()
    if not count:
        return Backlog(0.0, 0.0)
    pace = _DurationModel(session)
    first = session.execute(select(*_SORT).where(*waits).order_by(*QUEUE_ORDER).limit(MAX_JOBS))
    known = [seconds for one in first if (seconds := pace.of(*one)) is not None]
    return Backlog(count * fmean(known) if known else None, max(0.0, (now - oldest).total_seconds()))


def _skipped(present: Mapping[str, capabilities.Capabilities]) -> list[ColumnElement[bool]]:
    """Return SQL conditions that exclude jobs which no present worker can run, because they delay no other job."""
    able = capabilities.eligible_workers(None, present)
    return [or_(JobRow.kind.in_(LIVE_KINDS), capabilities.satisfiable_clause(able))] if able else []


def _last_end(free: list[datetime], lasting: list[float]) -> datetime:
    """Simulate the assignment of queued jobs to the first free worker, and return the end of the last job."""
    heapq.heapify(free)
    end = free[0]
    for seconds in lasting:
        end = heapq.heappop(free) + timedelta(seconds=seconds)
        heapq.heappush(free, end)
    return end


def _in_future(end: datetime | None, now: datetime) -> datetime | None:
    return end if end is not None and end > now else None


class _DurationModel:
    """Estimator of job durations: the median of recent jobs of the same class."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._past: dict[str, dict[Hashable, list[float]]] = {}

    def seconds(self, row: JobRow) -> float | None:
        """Return the estimated duration of a job in seconds; ``None`` for live jobs or with too few similar jobs."""
        parameters = row.payload.get("parameters") or {}
        return self.of(row.kind, parameters.get("method"), row.payload.get("format"), row.promised)

    def of(self, kind: str, method: str | None, form: str | None, promised: int) -> float | None:
        """Return the median duration in seconds of recent jobs of a class; ``None`` with too few jobs."""
        if kind in LIVE_KINDS:
            return None
        taken = self._of_kind(kind).get(_job_class(method, form, promised), [])
        return median(taken) if len(taken) >= MIN_SAMPLES else None

    def end_of(self, row: JobRow) -> datetime | None:
        """Return the estimated end time of a running job."""
        seconds = self.seconds(row)
        if seconds is None or not row.attempts:
            return None
        return datetime.fromisoformat(row.attempts[-1]["started"]) + timedelta(seconds=seconds)

    def _of_kind(self, kind: str) -> dict[Hashable, list[float]]:
        if kind not in self._past:
            found: dict[Hashable, list[float]] = {}
            # Columns, no rows: one that ran when this session read it would be given again as it was then.
            query = select(_METHOD, _FORMAT, JobRow.promised, JobRow.attempts)
            query = query.where(JobRow.kind == kind, JobRow.state == _R.SUCCEEDED)
            newest = self._session.execute(query.order_by(JobRow.sequence.desc()).limit(HISTORY))
            for method, form, promised, attempts in newest:
                if (seconds := _lasted(attempts)) is not None:
                    found.setdefault(_job_class(method, form, promised), []).append(seconds)
            self._past[kind] = found
        return self._past[kind]


def _lasted(attempts: Sequence[Mapping[str, Any]]) -> float | None:
    """Return the duration of a job's last attempt in seconds; ``None`` if it was not recorded."""
    last = attempts[-1] if attempts else {}
    if not (last.get("started") and last.get("ended")):
        return None
    return (datetime.fromisoformat(last["ended"]) - datetime.fromisoformat(last["started"])).total_seconds()


def _job_class(method: str | None, form: str | None, promised: int) -> Hashable:
    """Return the key of jobs with similar durations: method, format and order of magnitude of the output."""
    return method, form, round(math.log2(promised + 1))
