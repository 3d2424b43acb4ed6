"""Queue position and estimated completion time of waiting jobs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from statistics import median
from typing import Any

from sqlalchemy import ColumnElement, func, or_, select, tuple_
from sqlalchemy.orm import Session

from steradian.jobs.job import requirements_of
from steradian.jobs.queue import matching as capabilities
from steradian.jobs.queue.fair_queueing import QUEUE_ORDER, WAITS_FOR_SCAN
from steradian.jobs.registry import LIVE_KINDS
from steradian.storage.db.tables import JobRow
from steradian.storage.state_machines import ReconstructionState

HISTORY, MIN_SAMPLES = 50, 3
"""Newest jobs of a kind that are looked at, and how many of them tell how long one takes."""
_R = ReconstructionState


@dataclass(frozen=True)
class QueueEstimate:
    """Estimate for a queued or running job: position in the queue and expected end.

    Attributes
    ----------
    position
        1 for the next that begins; ``None`` when it runs, or waits for its scan or for another worker.
    expected_end
        From the expected ends of the running jobs and the median duration of this job's kind for those before it; the
        same at each look, so that its ETag holds. ``None`` when too few such jobs have been done, a worker is idle, or
        the running jobs take longer than they should.
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
    if row.state is _R.RUNNING:
        return QueueEstimate(None, _expected_end(session, row, now))
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
    running = session.scalars(select(JobRow).where(JobRow.state == _R.RUNNING)).all()
    seconds = _median_duration(session, row.kind)
    ends = sorted(end for job in running if (end := _expected_end(session, job, now)) is not None)
    if seconds is None or not ends or len(running) < workers:
        return QueueEstimate(ahead + 1)
    rounds, place = divmod(ahead, len(ends))
    return QueueEstimate(ahead + 1, ends[place] + timedelta(seconds=seconds * (rounds + 1)))


def _expected_end(session: Session, job: JobRow, now: datetime) -> datetime | None:
    """Return the expected end of a running job; ``None`` when it is overdue, or too few of its kind have been done."""
    seconds = _median_duration(session, job.kind)
    if seconds is None or not job.attempts:
        return None
    end = datetime.fromisoformat(job.attempts[-1]["started"]) + timedelta(seconds=seconds)
    return end if end > now else None


@dataclass(frozen=True)
class Backlog:
    """Backlog of the queue, for autoscaling of workers: seconds of queued work and age of the oldest job.

    Attributes
    ----------
    seconds
        How long one worker would take for all of it, by the median duration of each kind; jobs of a kind of which too
        few have been done count as the mean of the others. ``None`` where nothing can be said of any.
    oldest
        Seconds since the oldest job that waits was asked for; 0 when none waits.
    """

    seconds: float | None
    oldest: float


def backlog(session: Session, now: datetime, present: Mapping[str, capabilities.Capabilities]) -> Backlog:
    """Estimate the seconds of queued work for the present workers, and the age of the oldest queued job."""
    waits = [JobRow.state == _R.QUEUED, ~WAITS_FOR_SCAN, *_skipped(present)]
    kinds = session.execute(
        select(JobRow.kind, func.count(), func.min(JobRow.created)).where(*waits).group_by(JobRow.kind)
    ).all()
    if not kinds:
        return Backlog(0.0, 0.0)
    waiting = sum(count for _, count, _ in kinds)
    medians = [(count, _median_duration(session, kind)) for kind, count, _ in kinds]
    known = [(count, seconds) for count, seconds in medians if seconds is not None]
    work = waiting * sum(n * each for n, each in known) / sum(n for n, _ in known) if known else None
    return Backlog(work, max(0.0, (now - min(oldest for _, _, oldest in kinds)).total_seconds()))


def _skipped(present: Mapping[str, capabilities.Capabilities]) -> list[ColumnElement[bool]]:
    """Return SQL conditions that exclude jobs which no present worker can run, because they delay no other job."""
    able = capabilities.eligible_workers(None, present)
    return [or_(JobRow.kind.in_(LIVE_KINDS), capabilities.satisfiable_clause(able))] if able else []


def _median_duration(session: Session, kind: str) -> float | None:
    """Return the median duration in seconds of the newest jobs of a kind; ``None`` for live jobs or with too few."""
    if kind in LIVE_KINDS:
        return None
    # The column, not rows: a row that this session has read before would have its earlier values.
    newest = select(JobRow.attempts).where(JobRow.kind == kind, JobRow.state == _R.SUCCEEDED)
    done = session.scalars(newest.order_by(JobRow.sequence.desc()).limit(HISTORY))
    taken = [seconds for attempts in done if (seconds := _last_duration(attempts)) is not None]
    return median(taken) if len(taken) >= MIN_SAMPLES else None


def _last_duration(attempts: Sequence[Mapping[str, Any]]) -> float | None:
    """Return the duration of a job's last attempt in seconds; ``None`` if it was not recorded."""
    last = attempts[-1] if attempts else {}
    if not (last.get("started") and last.get("ended")):
        return None
    return (datetime.fromisoformat(last["ended"]) - datetime.fromisoformat(last["started"])).total_seconds()
