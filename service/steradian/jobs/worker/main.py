"""Worker process: claims jobs one at a time and runs each in a subprocess."""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from dbos import DBOS, DBOSConfig, WorkflowSerializationFormat
from dbos import error as engine_errors
from dbos._dbos import _get_dbos_instance
from dbos._sys_db import SystemDatabase
from sqlalchemy import ColumnElement, column, select

from steradian.core.settings import Settings
from steradian.jobs.queue.dbos import APPLICATION, APPLICATION_VERSION, QUEUE, WORKFLOW, queue_url, scanner_queue
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.jobs.queue.matching import Capabilities, WorkerRegistration, unsatisfied_clause
from steradian.jobs.worker.failover import claim_name, monitor_peers
from steradian.jobs.worker.memory_tuning import freeze_garbage_collector
from steradian.jobs.worker.queue_polling import LATEST_POLL, adaptive_wait
from steradian.jobs.worker.results import ResultUploader
from steradian.jobs.worker.runner import POLL, JobRunner
from steradian.jobs.worker.startup_check import wait_until_ready
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.change_detector import ChangeDetector
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.db.tables import JobRow

QUEUE_POLL: Final = 0.1
"""Seconds between looks at the queue of a worker that has nothing to do."""
REQUEUE_TIMEOUT: Final = 7.0
"""Seconds that a worker which is asked to end has to put its job back; the supervisor kills it after eight."""

_log = logging.getLogger(__name__)


def run_worker(
    settings: Settings, slot: int, commands: Mapping[str, Sequence[str]], has: Capabilities | None = None
) -> None:
    """Run a worker until SIGTERM or SIGINT: claim jobs one at a time and run each in a child process.

    Parameters
    ----------
    slot
        Number of this worker, from 0; no two running workers of one name may share it.
    commands
        Command of the child process for each job kind.
    has
        Capabilities: jobs that require more are left to other workers; ``None``: this machine's memory and no GPU.

    Raises
    ------
    Conflict
        When another worker of that name and number runs, or the database is of another version.
    InvalidInput
        When the data folder is not the database's.
    """
    name = settings.worker_slot_name(slot)
    wait_until_ready(settings)
    url = queue_url(settings)
    lock = claim_name(settings.database_url, name) if settings.database_url else None
    database = Database(metadata_url(settings))
    runner = JobRunner(settings, JobLedger(database), commands, name)
    if slot == 0:
        ResultUploader(settings, database).upload_leftovers(JobLedger(database), DataDirectory(settings.data))
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
    WorkerRegistration(database, name, has).start()
    SystemDatabase._claim_gate = _claim_filter(has)  # type: ignore[method-assign]  # private, so the minor version is pinned
    DBOS(config=config)
    logging.getLogger("dbos").addFilter(_is_not_cancellation)
    _register(runner)
    queue = scanner_queue(settings.scanner_id) if settings.is_scanner_node else QUEUE
    DBOS.listen_queues([queue])
    DBOS.launch()
    DBOS.register_queue(queue, worker_concurrency=1, polling_interval_sec=QUEUE_POLL)
    engine = _get_dbos_instance()
    engine._background_jobs_stop_event.set()  # jobs have neither delays nor deadlines in the engine
    for event in engine.background_thread_stop_events:  # private, so the minor version is pinned
        event.wait = adaptive_wait(event, runner, ChangeDetector(database, LATEST_POLL), QUEUE_POLL)  # type: ignore[assignment, method-assign]
    if lock is not None:
        # Until the process ends, not until it is asked to: others would take over the job that it may still finish.
        watch = (lock, threading.Event(), _pending_executors, lambda gone: _recover([gone]))
        threading.Thread(target=monitor_peers, args=watch, daemon=True).start()
    elif slot == 0:
        _recover_orphans(settings)
    freeze_garbage_collector()
    _log.info("%s waits for jobs; it has %s", name, has)
    while not runner.stopping.wait(POLL):
        pass  # a signal that another thread received is handled when this one wakes
    if not runner.idle.wait(settings.drain_seconds + REQUEUE_TIMEOUT):
        _log.error("%s could not put its job back in time; the next start of a worker does", name)
    logging.shutdown()
    os._exit(0)  # whatever the engine's threads do


def _claim_filter(has: Capabilities) -> Callable[..., list[ColumnElement[bool]]]:
    """Return a function with extra SQL conditions for the engine's claim query: only jobs this worker can run.

    Other jobs stay in the queue, and the next job that the worker can run is claimed.
    """
    too_much = select(JobRow.id).where(JobRow.id == column("workflow_uuid"), unsatisfied_clause(has)).exists()
    return lambda *_: [~too_much]


def _register(runner: JobRunner) -> None:
    """Register the DBOS workflow and its single step, which runs a job."""

    @DBOS.step(name="attempts", preemptible=True)
    async def attempts(job_id: str) -> str:
        return await runner.run(job_id)

    # Starts are counted in the ledger, so the engine's own limit is only a backstop.
    @DBOS.workflow(name=WORKFLOW, max_recovery_attempts=1000, serialization_type=WorkflowSerializationFormat.PORTABLE)
    async def workflow(job_id: str) -> str:
        return await attempts(job_id)


def _recover_orphans(settings: Settings) -> None:
    """Requeue the jobs of workers beyond the configured number, which no longer run."""
    present = {settings.worker_slot_name(slot) for slot in range(max(1, settings.workers))}
    if gone := _pending_executors() - present:
        _recover(sorted(gone))


def _recover(executors: list[str]) -> None:
    DBOS._recover_pending_workflows(executors)  # private, so the engine's minor version is pinned


def _pending_executors() -> set[str]:
    pending = DBOS.list_workflows(status="PENDING", load_input=False, load_output=False)
    return {job.executor_id for job in pending if job.executor_id}


def _is_not_cancellation(record: logging.LogRecord) -> bool:
    """Return false for the engine's log records about cancelled jobs (logging filter)."""
    cancelled = (engine_errors.DBOSAwaitedWorkflowCancelledError, engine_errors.DBOSWorkflowCancelledError)
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, cancelled) and "was cancelled" not in record.getMessage()
