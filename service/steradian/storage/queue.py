"""The job queue: the only module that knows its engine, DBOS Transact.

:class:`JobQueue` is the client: it submits, looks and cancels, and runs nothing. :func:`run_worker` is a worker
process: it takes jobs one at a time and runs each in a child process of its own. A worker that dies is started again
under the same executor name and takes its job up once more; the number of starts is kept with the job's progress.
"""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any, Final

from dbos import DBOS, DBOSClient, DBOSConfig, WorkflowSerializationFormat
from dbos import error as engine_errors
from ulid import ULID

from steradian.errors import Conflict, NotFound
from steradian.progress import Progress
from steradian.settings import Settings
from steradian.storage.database import use_write_ahead_log
from steradian.storage.job_process import run_child
from steradian.storage.job_status import to_status
from steradian.storage.jobs import MAX_ATTEMPTS, Died, Failed, JobRequest, JobStatus, QueueUnavailable, Succeeded
from steradian.storage.paths import DataDirectory
from steradian.storage.states import ReconstructionState

APPLICATION: Final = "steradian"
APPLICATION_VERSION: Final = "1"
"""Constant, or the engine leaves jobs of another build alone."""
QUEUE: Final = "jobs"
WORKFLOW: Final = "job"
PROGRESS: Final = "progress"
POLL: Final = 0.2
"""Seconds between looks at the queue, at a cancellation and between progress reports."""
BACKOFF: Final = 0.5
"""Seconds before the second start of a job whose process died; doubled for the third."""

_log = logging.getLogger(__name__)
_State = ReconstructionState


class JobQueue:
    """The client's side of the queue; may be used from many threads.

    Parameters
    ----------
    settings
        Whose data directory holds the queue; it is made when missing.

    Raises
    ------
    QueueUnavailable
        When the queue's database cannot be opened.
    """

    def __init__(self, settings: Settings) -> None:
        self._data = DataDirectory(settings.data)
        url = prepare(self._data)
        try:
            self._client = DBOSClient(system_database_url=url, application_name=APPLICATION)
        except Exception as error:
            raise QueueUnavailable(f"the job queue cannot be opened: {error}") from error

    def submit(self, request: JobRequest) -> str:
        """Queue a job and return its identifier; one that is queued already is left as it is."""
        self._client.enqueue(
            {
                "workflow_name": WORKFLOW,
                "queue_name": QUEUE,
                "workflow_id": request.id,
                "app_version": APPLICATION_VERSION,
                "serialization_type": WorkflowSerializationFormat.PORTABLE,
            },
            {"kind": request.kind, "payload": dict(request.payload)},
        )
        return request.id

    def status(self, job_id: str) -> JobStatus:
        """Tell how a job stands.

        Raises
        ------
        NotFound
            When the queue has no such job.
        """
        found = self._client.list_workflows(workflow_ids=[job_id], load_input=False)
        if not found:
            raise NotFound("job", job_id)
        progress = self._client.get_event(job_id, PROGRESS, timeout_seconds=0) or {}
        return to_status(found[0], progress, self._data.job(job_id).is_running)

    def cancel(self, job_id: str) -> JobStatus:
        """Cancel a job that waits or runs; its process is killed. Cancelling it again changes nothing.

        Raises
        ------
        NotFound
            When the queue has no such job.
        Conflict
            When it is over.
        """
        present = self.status(job_id)
        if present.state in {_State.SUCCEEDED, _State.FAILED}:
            raise Conflict(f"job {job_id} has {present.state} and cannot be cancelled any more")
        self._client.cancel_workflow(job_id)
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

    def close(self) -> None:
        """Close the connections."""
        self._client.destroy()


def prepare(data: DataDirectory) -> str:
    """Make the queue's database, bring it to the engine's newest version and return its URL."""
    data.create()
    logging.getLogger("dbos").setLevel(logging.WARNING)
    use_write_ahead_log(data.queue_file)
    url = f"sqlite:///{data.queue_file}"
    DBOS.migrate(url)
    return url


def new_job_id() -> str:
    """Make an identifier for a job that belongs to no resource."""
    return f"j{str(ULID()).lower()}"


def run_worker(settings: Settings, slot: int, commands: Mapping[str, Sequence[str]]) -> None:
    """Be a worker until SIGTERM or SIGINT: take jobs one at a time and run each in a process of its own.

    Parameters
    ----------
    slot
        Number of this worker, from 0; no two running workers of a data directory may share one.
    commands
        The program that runs each kind of job.
    """
    worker = _Worker(settings, commands)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: worker.stopping.set())
    data = DataDirectory(settings.data)
    config: DBOSConfig = {
        "name": APPLICATION,
        "system_database_url": prepare(data),
        "application_version": APPLICATION_VERSION,
        "executor_id": _executor(slot),
        "log_level": "WARNING",
    }
    DBOS(config=config)
    logging.getLogger("dbos").addFilter(_is_no_cancellation)
    worker.register()
    DBOS.listen_queues([QUEUE])
    DBOS.launch()
    DBOS.register_queue(QUEUE, worker_concurrency=1, polling_interval_sec=POLL)
    if slot == 0:
        _adopt_orphans(settings.workers)
    _log.info("worker %d waits for jobs", slot)
    worker.stopping.wait()
    worker.finish(within=5.0)


def _executor(slot: int) -> str:
    return f"worker-{slot}"


def _adopt_orphans(workers: int) -> None:
    """Queue again what workers left behind that no longer exist, because fewer are started than before."""
    present = {_executor(slot) for slot in range(workers)} | {_executor(0)}
    pending = DBOS.list_workflows(status="PENDING", load_input=False, load_output=False)
    gone = {job.executor_id for job in pending if job.executor_id} - present
    if gone:
        DBOS._recover_pending_workflows(sorted(gone))  # private, so the engine's minor version is pinned


class _Worker:
    """The engine's workflow of one step, and the way to leave it unfinished for the next start."""

    def __init__(self, settings: Settings, commands: Mapping[str, Sequence[str]]) -> None:
        self.stopping = threading.Event()
        self._idle = threading.Event()
        self._idle.set()
        self._settings, self._commands = settings, commands
        self._data = DataDirectory(settings.data)
        threads = str(settings.threads_per_job)
        limits = dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"), threads)
        self._environment = settings.environment() | limits

    def register(self) -> None:
        """Tell the engine of the workflow and its step."""

        @DBOS.step(name="attempts", preemptible=True)
        async def attempts(job_id: str, job: dict[str, Any]) -> dict[str, Any]:
            self._idle.clear()
            try:
                return await self._attempt_until_over(job_id, job)
            finally:
                self._idle.set()

        # The number of starts is counted with the progress, so the engine's own limit is only a backstop.
        @DBOS.workflow(
            name=WORKFLOW, max_recovery_attempts=1000, serialization_type=WorkflowSerializationFormat.PORTABLE
        )
        async def workflow(job: dict[str, Any]) -> dict[str, Any]:
            job_id = DBOS.workflow_id
            if job_id is None:
                raise RuntimeError("the engine runs a job without an identifier")
            return await attempts(job_id, job)

    def finish(self, within: float) -> None:
        """Wait until the running job is put back, then end the process, whatever the engine's threads do."""
        self._idle.wait(within)
        logging.shutdown()
        os._exit(0)

    async def _attempt_until_over(self, job_id: str, job: dict[str, Any]) -> dict[str, Any]:
        """Start the job's program until it succeeds, fails or has died too often; returns plain JSON."""
        last = await DBOS.get_event_async(job_id, PROGRESS, timeout_seconds=0) or {}
        attempt, died = int(last.get("attempt", 0)), str(last.get("died", "its worker died"))
        while attempt < MAX_ATTEMPTS:
            attempt += 1
            outcome = await self._attempt(job_id, job, attempt)
            if not isinstance(outcome, Died):
                return asdict(outcome) | {"attempt": attempt}
            died = outcome.message
            _log.warning("job %s, attempt %d: %s", job_id, attempt, died)
            if attempt < MAX_ATTEMPTS:
                await asyncio.sleep(BACKOFF * 2 ** (attempt - 1))
        return asdict(Failed("died", f"started {MAX_ATTEMPTS} times, last: {died}")) | {"attempt": attempt}

    async def _attempt(self, job_id: str, job: dict[str, Any], attempt: int) -> Succeeded | Failed | Died:
        command = self._commands.get(job["kind"])
        if command is None:
            return Failed("unknown-kind", f"no worker runs jobs of kind {job['kind']!r}")
        folder = self._data.job(job_id)
        tell = _Progress(attempt)
        await tell("starting", 0, 1)
        child = asyncio.ensure_future(
            run_child(
                command,
                job["payload"] | {"job": str(folder.root)},
                log=folder.log,
                environment=self._environment,
                report=tell,
                timeout=self._settings.job_timeout,
            )
        )
        try:
            while not child.done():
                await asyncio.wait({child}, timeout=POLL)
                if self.stopping.is_set() and not child.done():
                    await self._put_back(child, attempt)
                if await _is_cancelled(job_id):
                    await _kill(child)
                    await asyncio.Event().wait()  # the engine ends this step itself, within a second
            return child.result()
        finally:
            await _kill(child)

    async def _put_back(self, child: asyncio.Future[Any], attempt: int) -> None:
        """Leave the job to the next start of this worker as if this attempt had not been."""
        await _kill(child)
        await DBOS.set_event_async(PROGRESS, {"attempt": attempt - 1, "stage": "put back", "done": 0, "total": 1})
        self._idle.set()
        await asyncio.Event().wait()  # the process ends first


class _Progress:
    """Passes on progress at most every :data:`POLL` seconds, but every new stage and every end of one."""

    def __init__(self, attempt: int) -> None:
        self._attempt, self._stage, self._when = attempt, "", float("-inf")

    async def __call__(self, stage: str, done: int, total: int) -> None:
        now = time.monotonic()
        if stage == self._stage and done < total and now - self._when < POLL:
            return
        self._stage, self._when = stage, now
        value = {"attempt": self._attempt, "stage": stage, "done": done, "total": total}
        await DBOS.set_event_async(PROGRESS, value)


async def _is_cancelled(job_id: str) -> bool:
    found = await DBOS.list_workflows_async(workflow_ids=[job_id], load_input=False, load_output=False)
    return bool(found) and found[0].status == "CANCELLED"


async def _kill(child: asyncio.Future[Any]) -> None:
    child.cancel()
    await asyncio.wait({child})


def _is_no_cancellation(record: logging.LogRecord) -> bool:
    """Drop the engine's report, with traceback, of a job that a person cancelled."""
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, engine_errors.DBOSAwaitedWorkflowCancelledError) and (
        "was cancelled" not in record.getMessage()
    )
