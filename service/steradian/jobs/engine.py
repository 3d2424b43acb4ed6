"""The job queue: the only module that knows its engine, DBOS Transact.

:class:`JobQueue` is the client: it submits, looks and cancels, and runs nothing. :func:`run_worker` is a worker
process: it takes jobs one at a time and runs each in a child process. The engine decides who runs a job and when; how
a job stands is written in the ledger, which everybody reads.
"""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Final

from dbos import DBOS, DBOSClient, DBOSConfig, WorkflowSerializationFormat
from dbos import error as engine_errors
from dbos._dbos import _get_dbos_instance
from dbos._sys_db import SystemDatabase
from sqlalchemy import ColumnElement, column, make_url, select, text
from sqlalchemy.orm import Session
from ulid import ULID

from steradian.errors import NotFound, Superseded
from steradian.jobs.capabilities import Capabilities, Notice, own_scanner, unmet, workers
from steradian.jobs.heap import keep_libraries
from steradian.jobs.hurrying import hurried
from steradian.jobs.joining import ENGINE, engine_version, join
from steradian.jobs.keeping import JobKeeper
from steradian.jobs.ledger import JobLedger
from steradian.jobs.liveness import claim, watch_others
from steradian.jobs.model import Died, JobRequest, JobStatus, QueueUnavailable, requirements_of
from steradian.jobs.runner import POLL, JobRunner
from steradian.jobs.turns import place, renumber
from steradian.progress import Progress
from steradian.settings import Settings
from steradian.storage.advisory import TIMEOUTS
from steradian.storage.belonging import bind
from steradian.storage.changes import Changes
from steradian.storage.database import Database, metadata_url
from steradian.storage.paths import DataDirectory
from steradian.storage.repository import utc_now
from steradian.storage.scanners import PRESENT
from steradian.storage.states import ReconstructionState, is_terminal
from steradian.storage.subseconds import with_subseconds
from steradian.storage.tables import JobRow, ScannerRow

APPLICATION: Final = "steradian"
APPLICATION_VERSION: Final = "1"
"""Constant, or the engine leaves jobs of another build alone."""
QUEUE: Final = "jobs"
"""Beside it, each scanner whose node has workers has one for the images that grow with its scans."""
WORKFLOW: Final = "job"
WAITING: Final = frozenset({"ENQUEUED", "DELAYED"})
WAITING_OR_RUNNING: Final = WAITING | {"PENDING"}
"""The engine's states of jobs that are not over."""
QUEUE_POLL: Final = 0.1
"""Seconds between looks at the queue of a worker that has nothing to do."""
PUT_BACK_PATIENCE: Final = 7.0
"""Seconds that a worker which is asked to end has to put its job back; the supervisor kills it after eight."""

_log = logging.getLogger(__name__)
_R = ReconstructionState


class JobQueue:
    """The client's side of the queue; may be used from many threads.

    Parameters
    ----------
    settings
        Whose database or data directory holds the queue; both are made when missing.

    Raises
    ------
    QueueUnavailable
        When the queue's database cannot be opened.
    """

    def __init__(self, settings: Settings) -> None:
        self._data = DataDirectory(settings.data)
        try:
            url = prepare(settings)
            self._database = Database(metadata_url(settings))
            self._client = DBOSClient(system_database_url=url, application_name=APPLICATION)
        except Exception as error:
            raise QueueUnavailable(f"the job queue cannot be opened: {error}") from error
        self.ledger = JobLedger(self._database)
        self._doubted: frozenset[str] = frozenset()

    def submit(self, request: JobRequest) -> str:
        """Queue a job and return its identifier; one that is queued already is left as it is."""
        with self._database.write() as session:
            self.add(session, request)
        return request.id

    def add(self, session: Session, request: JobRequest) -> JobRow:
        """Note a job and queue it in the present transaction: both happen or neither does."""
        row = self.ledger.add(session, request)
        self._enqueue(session, row)
        return row

    def _enqueue(self, session: Session, row: JobRow) -> None:
        """Hand a job to the engine; doing it twice does it once, and one that follows a scan waits."""
        if is_terminal(row.state) or self.ledger.waits_for_scan(session, row):
            return
        self._client.enqueue_in_transaction(
            session,
            {
                "workflow_name": WORKFLOW,
                "queue_name": self._queue_of(session, row),
                "workflow_id": row.id,
                "app_version": APPLICATION_VERSION,
                "priority": place(row),
                "serialization_type": WorkflowSerializationFormat.PORTABLE,
            },
            row.id,
        )

    def _queue_of(self, session: Session, row: JobRow) -> str:
        """Name the queue of a job: what follows a scan is best done where its file grows, if a worker there can."""
        scanner = own_scanner(session, row.kind, row.scan_id)
        if scanner is None or _is_too_much(row, scanner, workers(session, utc_now())):
            return QUEUE
        return _queue_at(scanner)

    def status(self, job_id: str) -> JobStatus:
        """Tell how a job stands; raises :class:`NotFound`."""
        return self.ledger.status(job_id)

    def cancel(self, job_id: str, who: str = "local", reason: str | None = None) -> JobStatus:
        """Cancel a job that waits or runs; its process is killed. Cancelling it again changes nothing.

        Raises
        ------
        NotFound
            When there is no such job.
        Conflict
            When it is over.
        """
        before = self.ledger.get(job_id)
        self.ledger.want_cancelled(job_id, who, reason)
        self._client.cancel_workflow(job_id)
        if before.state is _R.QUEUED:
            self.ledger.cancelled(job_id, who)
        return self.status(job_id)

    def set_priority(self, job_id: str, priority: int, revision: int | None = None, who: str = "local") -> JobStatus:
        """Move a waiting job in the queue; see :meth:`JobLedger.set_priority`."""
        move = text(
            f"UPDATE {_engine_table(self._database)} SET priority = :place"  # noqa: S608 - one of two names
            " WHERE workflow_uuid = :job AND status IN ('ENQUEUED', 'DELAYED')"
        )
        with self._database.write() as session:
            row = self.ledger.set_priority(session, job_id, priority, revision, who)
            session.execute(move, {"job": job_id, "place": place(row)})
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
        """Follow a job until it is over or ``timeout`` seconds have passed, and tell how it stands then."""
        deadline = None if timeout is None else clock() + timeout
        while True:
            status = self.status(job_id)
            if progress is not None and status.stage is not None:
                progress(status.stage, status.done, status.total)
            if status.is_over or (deadline is not None and clock() >= deadline):
                return status
            sleep(POLL / 2)

    def reconcile(self) -> None:
        """Settle with the engine what a death, a full disk or an earlier release left; call it about once a second.

        A disagreement counts when it is seen twice in a row: a single one may be an operation under way. What waits
        and is unknown to the engine, because it followed a scan that waited too, for example, it is given at once.
        """
        rows = {row.id: row for row in self.ledger.unfinished()}
        found = (
            self._client.list_workflows(workflow_ids=list(rows), load_input=False, load_output=False) if rows else []
        )
        states = {job.workflow_id: job.status for job in found}
        self._leave_to_others([(rows[job.workflow_id], job.queue_name) for job in found if job.status in WAITING])
        doubted = {row.id for row in rows.values() if _disagree(row.state, states.get(row.id))}
        unknown = {row.id for row in rows.values() if row.state is _R.QUEUED and row.id not in states}
        for job_id in unknown | (doubted & self._doubted):
            self._settle(rows[job_id], states.get(job_id))
        self._doubted = frozenset(doubted)

    def _leave_to_others(self, waiting: Sequence[tuple[JobRow, str | None]]) -> None:
        """Move what waits for a scanner's own workers to everybody's queue where they are gone or cannot do it.

        Parameters
        ----------
        waiting
            Jobs and their queues.
        """
        if not (elsewhere := [(row, queue) for row, queue in waiting if queue != QUEUE]):
            return
        move = text(
            f"UPDATE {_engine_table(self._database)} SET queue_name = :everybody"  # noqa: S608 - one of two names
            " WHERE workflow_uuid = :job AND queue_name = :queue AND status IN ('ENQUEUED', 'DELAYED')"
        )
        with self._database.write() as session:
            scanners = session.scalars(select(ScannerRow.id).where(ScannerRow.follows, PRESENT))
            worked, known = {_queue_at(scanner): scanner for scanner in scanners}, workers(session, utc_now())
            for row, queue in elsewhere:
                scanner = worked.get(queue or "")
                if scanner is None or _is_too_much(row, scanner, known):
                    session.execute(move, {"everybody": QUEUE, "job": row.id, "queue": queue})
                    _log.warning("job %s is anybody's: no worker on its scanner's node can do it", row.id)

    def forget(self, job_ids: Sequence[str]) -> None:
        """Let the engine forget jobs that are over."""
        if job_ids:
            self._client.delete_workflows(list(job_ids))

    def close(self) -> None:
        """Close the connections."""
        self._client.destroy()
        self._database.close()

    def _settle(self, row: JobRow, engine_state: str | None) -> None:
        with suppress(Superseded, NotFound):  # it may have been deleted since it was looked at
            if row.state is _R.CANCELLING:
                if engine_state in WAITING_OR_RUNNING:
                    self._client.cancel_workflow(row.id)
                if not self._data.job(row.id).is_running:
                    self.ledger.cancelled(row.id, "service")
                return
            if engine_state is not None:
                died = Died(f"its worker could not go on; the queue's engine calls it {engine_state}")
                self.ledger.settle(row.id, row.fence, died, "service")
                self.forget([row.id])
            with self._database.write() as session:
                self._enqueue(session, self.ledger.reread(session, row.id))


def _disagree(state: ReconstructionState, engine_state: str | None) -> bool:
    return state is _R.CANCELLING or engine_state not in WAITING_OR_RUNNING


def _engine_table(database: Database) -> str:
    return "workflow_status" if database.is_file else "dbos.workflow_status"


def queue_url(settings: Settings) -> str:
    """Tell where the engine keeps the queue: beside the metadata."""
    if settings.database_url is None:
        return with_subseconds(metadata_url(settings))
    timeouts = {name: str(value) for name, value in TIMEOUTS.items()}
    return make_url(settings.database_url).update_query_dict(timeouts).render_as_string(hide_password=False)


def prepare(settings: Settings) -> str:
    """Bring the tables of ledger and engine to the newest version and return the engine's URL; workers never do this.

    Raises
    ------
    InvalidInput
        When the database belongs to another data folder or store.
    """
    DataDirectory(settings.data).create()
    logging.getLogger("dbos").setLevel(logging.WARNING)
    database = Database(metadata_url(settings))
    try:
        database.migrate()
        bind(settings, database)
        with database.migrating():
            DBOS.migrate(queue_url(settings))
        with database.write() as session:
            renumber(session, _engine_table(database))
            database.note(session, ENGINE, engine_version())
    finally:
        database.close()
    return queue_url(settings)


def new_job_id() -> str:
    """Make an identifier for a job that belongs to no resource."""
    return f"j{str(ULID()).lower()}"


def run_worker(
    settings: Settings, slot: int, commands: Mapping[str, Sequence[str]], has: Capabilities | None = None
) -> None:
    """Be a worker until SIGTERM or SIGINT: take jobs one at a time and run each in a child process.

    Parameters
    ----------
    slot
        Number of this worker, from 0; no two running workers of one name may share it.
    commands
        The program that runs each kind of job.
    has
        What it has: jobs that require more are left to others; ``None``: this machine's memory and no GPU.

    Raises
    ------
    Conflict
        When another worker of that name and number runs, or the database is of another version.
    InvalidInput
        When the data folder is not the database's.
    """
    name = settings.executor(slot)
    join(settings)
    url = queue_url(settings)
    lock = claim(settings.database_url, name) if settings.database_url else None
    database = Database(metadata_url(settings))
    runner = JobRunner(settings, JobLedger(database), commands, name)
    if slot == 0:
        JobKeeper(settings, database).tidy(JobLedger(database), DataDirectory(settings.data))
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: runner.stopping.set())
    config: DBOSConfig = {
        "name": APPLICATION,
        "system_database_url": url,
        "application_version": APPLICATION_VERSION,
        "executor_id": name,
        "log_level": "WARNING",
        "use_listen_notify": False,
        "run_migrations": False,
    }
    has = has or Capabilities.of_this_machine(settings, None)
    Notice(database, name, has).put_up()
    SystemDatabase._claim_gate = _gate(has)  # type: ignore[method-assign]  # private, so the minor version is pinned
    DBOS(config=config)
    logging.getLogger("dbos").addFilter(_is_no_cancellation)
    _register(runner)
    queue = _queue_at(settings.scanner_id) if settings.follows else QUEUE
    DBOS.listen_queues([queue])
    DBOS.launch()
    DBOS.register_queue(queue, worker_concurrency=1, polling_interval_sec=QUEUE_POLL)
    for event in _get_dbos_instance().background_thread_stop_events:  # private, so the minor version is pinned
        event.wait = hurried(event, runner, Changes(database), QUEUE_POLL)  # type: ignore[assignment, method-assign]
    if lock is not None:
        # Until the process ends, not until it is asked to: others would take over the job that it may still finish.
        watch = (lock, threading.Event(), _pending_executors, lambda gone: _recover([gone]))
        threading.Thread(target=watch_others, args=watch, daemon=True).start()
    elif slot == 0:
        _adopt_orphans(settings)
    keep_libraries()
    _log.info("%s waits for jobs; it has %s", name, has)
    while not runner.stopping.wait(POLL):
        pass  # a signal that another thread received is handled when this one wakes
    if not runner.idle.wait(settings.drain_seconds + PUT_BACK_PATIENCE):
        _log.error("%s could not put its job back in time; the next start of a worker does", name)
    logging.shutdown()
    os._exit(0)  # whatever the engine's threads do


def _gate(has: Capabilities) -> Callable[..., list[ColumnElement[bool]]]:
    """Make the conditions of a claim that the engine adds to its own: jobs that this worker cannot do are passed over.

    They stay where they are in the queue, and the next that it can do is taken.
    """
    too_much = select(JobRow.id).where(JobRow.id == column("workflow_uuid"), unmet(has)).exists()
    return lambda *_: [~too_much]


def _queue_at(scanner_id: str) -> str:
    return f"{QUEUE}-{scanner_id}"


def _is_too_much(row: JobRow, scanner_id: str, known: Mapping[str, Capabilities]) -> bool:
    """Whether a scanner's own workers are there and none of them can do it."""
    own = [has for has in known.values() if has.scanner_id == scanner_id]
    return bool(own) and not any(has.meet(requirements_of(row)) for has in own)


def _register(runner: JobRunner) -> None:
    """Tell the engine of the workflow and its one step."""

    @DBOS.step(name="attempts", preemptible=True)
    async def attempts(job_id: str) -> str:
        return await runner.run(job_id)

    # Starts are counted in the ledger, so the engine's own limit is only a backstop.
    @DBOS.workflow(name=WORKFLOW, max_recovery_attempts=1000, serialization_type=WorkflowSerializationFormat.PORTABLE)
    async def workflow(job_id: str) -> str:
        return await attempts(job_id)


def _adopt_orphans(settings: Settings) -> None:
    """Queue again what workers left behind that no longer exist, because fewer are started than before."""
    present = {settings.executor(slot) for slot in range(max(1, settings.workers))}
    if gone := _pending_executors() - present:
        _recover(sorted(gone))


def _recover(executors: list[str]) -> None:
    DBOS._recover_pending_workflows(executors)  # private, so the engine's minor version is pinned


def _pending_executors() -> set[str]:
    pending = DBOS.list_workflows(status="PENDING", load_input=False, load_output=False)
    return {job.executor_id for job in pending if job.executor_id}


def _is_no_cancellation(record: logging.LogRecord) -> bool:
    """Drop the engine's report, with traceback, of a job that a person cancelled."""
    cancelled = (engine_errors.DBOSAwaitedWorkflowCancelledError, engine_errors.DBOSWorkflowCancelledError)
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, cancelled) and "was cancelled" not in record.getMessage()
