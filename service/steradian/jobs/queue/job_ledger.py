"""Job ledger: the repository that alone changes job states, with fencing tokens and history."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from sqlalchemy import ColumnElement, func, select, update
from sqlalchemy.orm import Session

from steradian.core.exceptions import Conflict, NotFound, StaleFence
from steradian.core.logging_config import bind_request_id, request_id
from steradian.jobs.job import (
    MAX_ATTEMPTS,
    MAX_INTERRUPTIONS,
    Crashed,
    Failed,
    JobRequest,
    JobStatus,
    Outcome,
    Requeued,
    Succeeded,
    requirements_of,
)
from steradian.jobs.queue.fair_queueing import WAITS_FOR_SCAN, next_start_tag
from steradian.jobs.registry import LIVE_KINDS, resource_of
from steradian.storage.db.tables import JobRow
from steradian.storage.repositories.base import Repository
from steradian.storage.repositories.event_log import append_event
from steradian.storage.repositories.scans import RevisionConflict
from steradian.storage.state_machines import (
    BatchState,
    DesiredJobState,
    ReconstructionState,
    check_job_transition,
    is_terminal,
)

_R = ReconstructionState
_log = logging.getLogger(__name__)
_UNFINISHED = [state for state in _R if not is_terminal(state)]


class JobLedger(Repository[JobRow]):
    """Repository of jobs with their states, attempts, progress and history."""

    kind, table = "job", JobRow

    def add(self, session: Session, request: JobRequest) -> JobRow:
        """Insert a job's row in state queued; an existing row with the same identifier is returned unchanged."""
        found = session.scalars(select(JobRow).where(JobRow.id == request.id)).one_or_none()
        if found is not None:
            return found
        now = self.clock()
        row = JobRow(
            id=request.id,
            kind=request.kind,
            resource=resource_of(request.kind),
            payload=dict(request.payload),
            scan_id=request.payload.get("scan_id"),
            batch_id=request.batch_id,
            simulated=request.simulated,
            request_id=request_id.get() or None,
            owner=request.principal,
            priority=request.priority,
            turn=next_start_tag(session, request.principal, request.priority),
            timeout=request.timeout,
            requires_memory=request.requires.memory,
            requires_cores=request.requires.cores,
            requires_gpu=request.requires.gpu,
            state=_R.QUEUED,
            fence=0,
            desired_state=DesiredJobState.SUCCEEDED,
            created=now,
            attempt=0,
            attempts=[],
            done=0,
            total=0,
            history=[{"state": _R.QUEUED, "at": now.isoformat(), "who": request.principal, "why": "requested"}],
        )
        session.add(row)
        append_event(session, now, row.resource, row.id, self._event(row, request.principal, "requested"))
        return row

    def status(self, job_id: str) -> JobStatus:
        """Return the status of a job; raises :class:`NotFound`."""
        return to_status(self.get(job_id))

    def state_and_fence(self, job_id: str) -> tuple[ReconstructionState, int]:
        """Return a job's state and fencing token (number of its newest attempt); raises :class:`NotFound`."""
        with self.database.read() as session:
            found = session.execute(select(JobRow.state, JobRow.fence).where(JobRow.id == job_id)).one_or_none()
        if found is None:
            raise NotFound(self.kind, job_id)
        return found.state, found.fence

    def statuses(self, job_ids: list[str]) -> dict[str, JobStatus]:
        """Return the status of several jobs, by identifier."""
        with self.database.read() as session:
            return {row.id: to_status(row) for row in session.scalars(select(JobRow).where(JobRow.id.in_(job_ids)))}

    def reconstruction(self, identifier: str) -> JobStatus:
        """Return the status of a job that writes a volume; raises :class:`NotFound`, also for another job."""
        try:
            row = self.get(identifier)
        except NotFound:
            row = None
        if row is None or row.resource != "reconstruction":
            raise NotFound("reconstruction", identifier)
        return to_status(row)

    def of_batch(self, batch_id: str) -> list[JobStatus]:
        """Return the statuses of a batch's jobs in the order of their requests."""
        query = select(JobRow).where(JobRow.batch_id == batch_id).order_by(JobRow.sequence)
        with self.database.read() as session:
            return [to_status(row) for row in session.scalars(query)]

    def waits_for_scan(self, session: Session, row: JobRow) -> bool:
        """Return whether a live job must wait because its scan is still queued."""
        if row.kind not in LIVE_KINDS:
            return False
        return session.scalar(select(JobRow.id).where(JobRow.id == row.id, WAITS_FOR_SCAN)) is not None

    def unfinished(self) -> list[JobRow]:
        """Return all unfinished jobs, oldest first, except live jobs of queued scans."""
        waits = (JobRow.state == _R.QUEUED) & WAITS_FOR_SCAN
        query = select(JobRow).where(JobRow.state.in_(_UNFINISHED), ~waits).order_by(JobRow.sequence)
        with self.database.read() as session:
            return list(session.scalars(query))

    def lock_row(self, session: Session, job_id: str) -> JobRow:
        """Return a job's row, locked until the transaction ends; raises :class:`NotFound`."""
        return self._find(session, job_id, lock=True)

    def counts(self) -> dict[str, int]:
        """Count the jobs in each state."""
        with self.database.read() as session:
            return self._counts(session)

    def _counts(self, session: Session, *where: ColumnElement[bool]) -> dict[str, int]:
        query = select(JobRow.state, func.count()).where(*where).group_by(JobRow.state)
        return {str(state): count for state, count in session.execute(query)}

    def start_attempt(self, job_id: str, worker: str, after: int = 0) -> JobRow:
        """Start the next attempt of a queued job; a running job's attempt is first recorded as crashed.

        An attempt that is still open belongs to a worker that is gone, or cut off: from now on its number, ``fence``
        of the row, is not the current one.

        Parameters
        ----------
        after
            The newest start that the job's folder knows: a database that was restored may know only earlier ones.
        """

        def change(session: Session, row: JobRow) -> None:
            if row.state is _R.RUNNING:
                self._close_attempt(session, row, Crashed("its worker died"), worker)
            if row.state is not _R.QUEUED:
                return
            row.attempt, row.fence = row.attempt + 1, max(row.fence, after) + 1
            opened = {"number": row.attempt, "start": row.fence, "worker": worker, "started": self.clock().isoformat()}
            row.attempts = [*row.attempts, opened | {"ended": None, "outcome": None, "detail": None}]
            row.stage, row.done, row.total = "starting", 0, 1
            row.started = row.started or self.clock()
            self._move(session, row, _R.RUNNING, worker, f"attempt {row.attempt}")

        return self._transact(job_id, change)

    def finish_attempt(self, job_id: str, fence: int, outcome: Outcome, worker: str) -> JobRow:
        """Record the outcome of an attempt; a crashed job is queued again until it has used all its attempts.

        Parameters
        ----------
        fence
            Number of the start.

        Raises
        ------
        StaleFence
            When it is not the newest start any more; nothing has changed then.
        """

        def change(session: Session, row: JobRow) -> None:
            if row.state is _R.RUNNING:
                self._close_attempt(session, row, outcome, worker)
            elif row.state is _R.CANCELLING:
                self._end_cancelled(session, row, worker)

        return self._fenced(job_id, fence, change)

    def requeue(self, job_id: str, fence: int, worker: str, why: str = "the worker was stopped") -> JobRow:
        """Queue a running job again without counting the attempt; raises :class:`StaleFence`."""

        def change(session: Session, row: JobRow) -> None:
            if row.state is _R.RUNNING:
                self._put_back(session, row, "put back", worker, why)

        return self._fenced(job_id, fence, change)

    def request_cancellation(self, job_id: str, who: str, reason: str | None) -> JobRow:
        """Set the desired state of a job to cancelled and its state to cancelling; repeated calls have no effect.

        Raises
        ------
        Conflict
            When it is over otherwise.
        """

        def change(session: Session, row: JobRow) -> None:
            if row.desired_state is DesiredJobState.CANCELLED:
                return
            if is_terminal(row.state):
                raise Conflict(f"job {job_id} has {row.state} and cannot be cancelled any more")
            row.desired_state, row.reason = DesiredJobState.CANCELLED, reason
            self._move(session, row, _R.CANCELLING, who, reason or "requested")

        return self._transact(job_id, change)

    def cancelled(self, job_id: str, who: str, fence: int | None = None) -> JobRow:
        """Change a job from cancelling to cancelled, after its process has ended.

        Raises
        ------
        StaleFence
            When start number ``fence``, of which nothing runs any more, is not the newest.
        """

        def change(session: Session, row: JobRow) -> None:
            if row.state is _R.CANCELLING:
                self._end_cancelled(session, row, who)

        return self._transact(job_id, change) if fence is None else self._fenced(job_id, fence, change)

    def set_priority(
        self, session: Session, job_id: str, priority: int, revision: int | None = None, who: str = "local"
    ) -> JobRow:
        """Change a job's priority and append an event; with ``revision``, only if the row is unchanged since.

        Raises
        ------
        Conflict
            When the job waits no more; of the kind :class:`RevisionConflict` when it has changed.
        """
        row = self._find(session, job_id, lock=True)
        if revision is not None and row.revision != revision:
            raise RevisionConflict(f"job {job_id} has changed since; read it again")
        if row.state is not _R.QUEUED:
            raise Conflict(f"job {job_id} is {row.state}; only a queued one has a place in the queue")
        if row.priority != priority:
            row.priority = priority
            append_event(session, self.clock(), row.resource, row.id, self._event(row, who, "moved in the queue"))
        return row

    def report(self, job_id: str, fence: int, stage: str, done: int, total: int) -> None:
        """Store the progress of a job's current attempt; raises :class:`StaleFence` for an older attempt.

        The row's revision stays unchanged, because clients cannot change progress.
        """

        def change(session: Session, row: JobRow) -> None:
            if row.state is _R.RUNNING:
                progress = update(JobRow).where(JobRow.id == row.id)
                session.execute(progress.values(stage=stage[:120], done=done, total=total))

        self._fenced(job_id, fence, change)

    def _fenced(self, job_id: str, fence: int, change: Callable[[Session, JobRow], object]) -> JobRow:
        def checked(session: Session, row: JobRow) -> None:
            if row.fence != fence:
                raise StaleFence(f"start {fence} of job {job_id} counts no more; start {row.fence} has begun")
            change(session, row)

        return self._transact(job_id, checked)

    def _transact(self, job_id: str, change: Callable[[Session, JobRow], object]) -> JobRow:
        with self.database.write() as session:
            row = self._find(session, job_id, lock=True)
            known = len(row.history)
            change(session, row)
        with bind_request_id(request_id.get() or row.request_id):
            for move in row.history[known:]:
                _log.info("job %s is %s: %s (%s)", row.id, move["state"], move["why"], move["who"])
        return row

    def _close_attempt(self, session: Session, row: JobRow, outcome: Outcome, worker: str) -> None:
        match outcome:
            case Succeeded(result, announce):
                if announce is not None:
                    announce(session)
                self._note_end(row, "succeeded", None)
                row.result = result
                self._move(session, row, _R.SUCCEEDED, worker, f"attempt {row.attempt} succeeded")
            case Failed(code, message):
                self._note_end(row, "failed", message)
                self._fail(session, row, worker, code, message)
            case Crashed(message):
                self._note_end(row, "died", message)
                if row.attempt < MAX_ATTEMPTS:
                    self._move(session, row, _R.QUEUED, worker, message)
                else:
                    self._fail(session, row, worker, "died", f"started {MAX_ATTEMPTS} times, last: {message}")
            case Requeued(message):
                if sum(start["outcome"] == "interrupted" for start in row.attempts) + 1 < MAX_INTERRUPTIONS:
                    self._put_back(session, row, "interrupted", worker, message)
                else:
                    self._note_end(row, "interrupted", message)
                    self._fail(session, row, worker, "interrupted", f"again and again, last: {message}")

    def _put_back(self, session: Session, row: JobRow, outcome: str, worker: str, why: str) -> None:
        """Queue a job again without counting the attempt."""
        self._note_end(row, outcome, why)
        row.attempt, row.stage, row.done, row.total = row.attempt - 1, f"put back: {why}"[:120], 0, 1
        self._move(session, row, _R.QUEUED, worker, why)

    def _fail(self, session: Session, row: JobRow, worker: str, code: str, message: str) -> None:
        row.error_code, row.error = code, message
        self._move(session, row, _R.FAILED, worker, message)

    def _end_cancelled(self, session: Session, row: JobRow, who: str) -> None:
        self._note_end(row, "cancelled", row.reason)
        self._move(session, row, _R.CANCELLED, who, row.reason or "nothing of it runs any more")

    def _note_end(self, row: JobRow, outcome: str, detail: str | None) -> None:
        if row.attempts and row.attempts[-1].get("ended") is None:
            ended = {"ended": self.clock().isoformat(), "outcome": outcome, "detail": detail}
            row.attempts = [*row.attempts[:-1], row.attempts[-1] | ended]

    def _move(self, session: Session, row: JobRow, following: ReconstructionState, who: str, why: str) -> None:
        check_job_transition(row.id, row.state, following)
        now = self.clock()
        row.state = following
        row.history = [*row.history, {"state": following, "at": now.isoformat(), "who": who, "why": why}]
        if is_terminal(following):
            row.ended = now
        append_event(session, now, row.resource, row.id, self._event(row, who, why))
        if row.batch_id is not None:
            # Only now, as events are written in turns: of two jobs that end at once the second sees the first.
            counts = self._counts(session, JobRow.batch_id == row.batch_id)
            told = {"state": BatchState.of(counts), "counts": counts, "scan_id": row.scan_id, "who": who}
            append_event(session, now, "batch", row.batch_id, told)

    def _event(self, row: JobRow, who: str, why: str) -> dict[str, Any]:
        about = {"scan_id": row.scan_id, "batch_id": row.batch_id, "priority": row.priority}
        return {"state": row.state, "attempt": row.attempt, "who": who, "why": why, **about}


def to_status(row: JobRow) -> JobStatus:
    """Convert a job's database row to a :class:`JobStatus`."""
    return JobStatus(
        id=row.id,
        kind=row.kind,
        payload=row.payload,
        scan_id=row.scan_id,
        batch_id=row.batch_id,
        simulated=row.simulated,
        state=row.state,
        desired_state=row.desired_state,
        reason=row.reason,
        revision=row.revision,
        priority=row.priority,
        turn=row.turn,
        requires=requirements_of(row),
        attempt=row.attempt,
        attempts=row.attempts,
        history=row.history,
        stage=row.stage,
        done=row.done or 0,
        total=row.total or 0,
        error_code=row.error_code,
        error=row.error,
        request_id=row.request_id,
        created=row.created,
        started=row.started,
        ended=row.ended,
        result=row.result or {},
    )
