"""Client side of the job queue: submit, cancel, reprioritise, reconcile."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Final

from dbos import DBOSClient, WorkflowSerializationFormat
from sqlalchemy import select, text
from sqlalchemy.orm import Session
from ulid import ULID

from steradian.core.exceptions import NotFound, StaleFence
from steradian.core.progress import Progress
from steradian.core.settings import Settings
from steradian.jobs.job import Crashed, JobRequest, JobStatus, QueueUnavailable, requirements_of
from steradian.jobs.queue.dbos import (
    APPLICATION,
    APPLICATION_VERSION,
    QUEUE,
    WORKFLOW,
    migrate_queue,
    scanner_queue,
    workflow_table,
)
from steradian.jobs.queue.fair_queueing import queue_priority
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.jobs.queue.matching import Capabilities, dedicated_scanner, present_workers
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.change_detector import MAX_IDLE_INTERVAL, ChangeDetector
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.db.tables import JobRow, ScannerRow
from steradian.storage.db.timestamps_and_ids import utc_now
from steradian.storage.repositories.scanner_lease_and_stop import PRESENT
from steradian.storage.state_machines import ReconstructionState, is_terminal

WAITING: Final = frozenset({"ENQUEUED", "DELAYED"})
WAITING_OR_RUNNING: Final = WAITING | {"PENDING"}
"""The engine's states of jobs that are not over."""
POLL_INTERVAL: Final = 0.1

_log = logging.getLogger(__name__)
_R = ReconstructionState


class JobQueue:
    """Thread-safe client of the job queue: submit, cancel, reprioritise and wait for jobs.

    Parameters
    ----------
    settings
        Settings with the database or data directory of the queue; both are created if missing.

    Raises
    ------
    QueueUnavailable
        When the queue's database cannot be opened.
    """

    def __init__(self, settings: Settings) -> None:
        self._data = DataDirectory(settings.data)
        try:
            url = migrate_queue(settings)
            self._database = Database(metadata_url(settings))
            self._client = DBOSClient(system_database_url=url, application_name=APPLICATION)
        except Exception as error:
            raise QueueUnavailable(f"the job queue cannot be opened: {error}") from error
        self.ledger = JobLedger(self._database)
        self._doubted: frozenset[str] = frozenset()
        self._changes, self._is_busy = ChangeDetector(self._database, MAX_IDLE_INTERVAL), True

    def submit(self, request: JobRequest) -> str:
        """Queue a job and return its identifier; a job that is already queued stays unchanged."""
        with self._database.write() as session:
            self.add(session, request)
        return request.id

    def add(self, session: Session, request: JobRequest) -> JobRow:
        """Store a job's row and enqueue the job in the caller's transaction, so that both happen or neither."""
        row = self.ledger.add(session, request)
        self._enqueue(session, row)
        return row

    def _enqueue(self, session: Session, row: JobRow) -> None:
        """Enqueue a job in the queue engine (idempotent), unless the job has ended or its scan is still queued."""
        if is_terminal(row.state) or self.ledger.waits_for_scan(session, row):
            return
        self._client.enqueue_in_transaction(
            session,
            {
                "workflow_name": WORKFLOW,
                "queue_name": self._queue_of(session, row),
                "workflow_id": row.id,
                "app_version": APPLICATION_VERSION,
                "priority": queue_priority(row),
                "serialization_type": WorkflowSerializationFormat.PORTABLE,
            },
            row.id,
        )

    def _queue_of(self, session: Session, row: JobRow) -> str:
        """Return the name of the engine's queue for a job.

        Jobs that follow a scan prefer the node of its file, if a worker there can run them.
        """
        scanner = dedicated_scanner(session, row.kind, row.scan_id)
        if scanner is None or _exceeds_scanner_workers(row, scanner, present_workers(session, utc_now())):
            return QUEUE
        return scanner_queue(scanner)

    def status(self, job_id: str) -> JobStatus:
        """Return the status of a job; raises :class:`NotFound`."""
        return self.ledger.status(job_id)

    def cancel(self, job_id: str, who: str = "local", reason: str | None = None) -> JobStatus:
        """Cancel a queued or running job and kill its process; repeated calls have no effect.

        Raises
        ------
        NotFound
            When there is no such job.
        Conflict
            When it is over.
        """
        before = self.ledger.get(job_id)
        self.ledger.request_cancellation(job_id, who, reason)
        self._client.cancel_workflow(job_id)
        if before.state is _R.QUEUED:
            self.ledger.cancelled(job_id, who)
        return self.status(job_id)

    def set_priority(self, job_id: str, priority: int, revision: int | None = None, who: str = "local") -> JobStatus:
        """Change the priority of a queued job in the ledger and in the queue engine."""
        move = text(
            f"UPDATE {workflow_table(self._database)} SET priority = :place"  # noqa: S608 - one of two names
            " WHERE workflow_uuid = :job AND status IN ('ENQUEUED', 'DELAYED')"
        )
        with self._database.write() as session:
            row = self.ledger.set_priority(session, job_id, priority, revision, who)
            session.execute(move, {"job": job_id, "place": queue_priority(row)})
        return self.status(job_id)

    def wait(
        self,
        job_id: str,
        *,
        progress: Progress | None = None,
        timeout: float | None = None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] = time.sleep,
    ) -> JobStatus:
        """Wait until a job has ended or ``timeout`` seconds have passed, and return its status."""
        deadline = None if timeout is None else clock() + timeout
        while True:
            status = self.status(job_id)
            if progress is not None and status.stage is not None:
                progress(status.stage, status.done, status.total)
            if status.is_over or (deadline is not None and clock() >= deadline):
                return status
            sleep(POLL_INTERVAL)

    def reconcile(self) -> None:
        """Repair differences between ledger and queue engine after crashes; to be called about once a second.

        Without unfinished jobs, the queue is read only after a change of the database.

        A difference is repaired when it is seen twice in a row, because a single one may be an operation under way.
        Queued jobs that are unknown to the engine, live jobs of a queued scan for example, are enqueued at once.
        """
        if not (self._changes.has_changed() or self._is_busy):
            return
        self._is_busy = True
        rows = {row.id: row for row in self.ledger.unfinished()}
        found = (
            self._client.list_workflows(workflow_ids=list(rows), load_input=False, load_output=False) if rows else []
        )
        states = {job.workflow_id: job.status for job in found}
        self._leave_to_others([(rows[job.workflow_id], job.queue_name) for job in found if job.status in WAITING])
        doubted = {row.id for row in rows.values() if _states_differ(row.state, states.get(row.id))}
        unknown = {row.id for row in rows.values() if row.state is _R.QUEUED and row.id not in states}
        for job_id in unknown | (doubted & self._doubted):
            self._settle(rows[job_id], states.get(job_id))
        self._doubted, self._is_busy = frozenset(doubted), bool(rows)

    def _leave_to_others(self, waiting: Sequence[tuple[JobRow, str | None]]) -> None:
        """Move jobs from a scanner's queue to the common queue if the scanner's workers are gone or too small.

        Parameters
        ----------
        waiting
            Jobs and their queues.
        """
        if not (elsewhere := [(row, queue) for row, queue in waiting if queue != QUEUE]):
            return
        move = text(
            f"UPDATE {workflow_table(self._database)} SET queue_name = :everybody"  # noqa: S608 - one of two names
            " WHERE workflow_uuid = :job AND queue_name = :queue AND status IN ('ENQUEUED', 'DELAYED')"
        )
        with self._database.write() as session:
            scanners = session.scalars(select(ScannerRow.id).where(ScannerRow.follows, PRESENT))
            worked, known = (
                {scanner_queue(scanner): scanner for scanner in scanners},
                present_workers(session, utc_now()),
            )
            for row, queue in elsewhere:
                scanner = worked.get(queue or "")
                if scanner is None or _exceeds_scanner_workers(row, scanner, known):
                    session.execute(move, {"everybody": QUEUE, "job": row.id, "queue": queue})
                    _log.warning("job %s is open to all workers: no worker on its scanner's node can run it", row.id)

    def forget(self, job_ids: Sequence[str]) -> None:
        """Delete ended jobs from the tables of the queue engine."""
        if job_ids:
            self._client.delete_workflows(list(job_ids))

    def close(self) -> None:
        """Close the connections to the database and the queue engine."""
        self._client.destroy()
        self._database.close()

    def _settle(self, row: JobRow, engine_state: str | None) -> None:
        with suppress(StaleFence, NotFound):  # it may have been deleted since it was looked at
            if row.state is _R.CANCELLING:
                if engine_state in WAITING_OR_RUNNING:
                    self._client.cancel_workflow(row.id)
                if not self._data.job(row.id).is_running:
                    self.ledger.cancelled(row.id, "service")
                return
            if engine_state is not None:
                died = Crashed(f"its worker could not continue; the queue engine reports {engine_state}")
                self.ledger.finish_attempt(row.id, row.fence, died, "service")
                self.forget([row.id])
            with self._database.write() as session:
                self._enqueue(session, self.ledger.lock_row(session, row.id))


def new_job_id() -> str:
    """Return a new identifier (j and a ULID) for a job without a resource of its own."""
    return f"j{str(ULID()).lower()}"


def _states_differ(state: ReconstructionState, engine_state: str | None) -> bool:
    return state is _R.CANCELLING or engine_state not in WAITING_OR_RUNNING


def _exceeds_scanner_workers(row: JobRow, scanner_id: str, known: Mapping[str, Capabilities]) -> bool:
    """Return whether a scanner has workers of its own but none of them meets a job's requirements."""
    own = [has for has in known.values() if has.scanner_id == scanner_id]
    return bool(own) and not any(has.satisfies(requirements_of(row)) for has in own)
