"""Execution of one job by a worker: attempts, progress, cancellation, requeueing."""

from __future__ import annotations

import asyncio
import gc
import logging
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, Final, TypeVar

from sqlalchemy.exc import DBAPIError, InterfaceError, OperationalError, SQLAlchemyError
from sqlalchemy.exc import TimeoutError as NoConnection
from sqlalchemy.orm.exc import StaleDataError

from steradian.core.exceptions import NotFound, StaleFence, StoreUnavailable
from steradian.core.logging_config import request_id, request_id_suffix
from steradian.core.settings import Settings
from steradian.core.signal_safe_event import SignalSafeEvent
from steradian.jobs.job import Crashed, Failed, Outcome, Requeued, Succeeded
from steradian.jobs.queue.job_ledger import JobLedger
from steradian.jobs.registry import JOB_TYPES
from steradian.jobs.worker.process import JobProcess
from steradian.jobs.worker.results import ResultUploader
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.db.tables import JobRow
from steradian.storage.maintenance.permissions import unwritable_job, unwritable_jobs
from steradian.storage.state_machines import ReconstructionState

POLL: Final = 0.2
"""Seconds between looks at a cancellation and between progress reports."""
FAST_POLL_WINDOW: Final = 0.5
"""Seconds after a job's end for which the next one is looked for almost without a pause."""
BACKOFF: Final = 0.5
"""Seconds before the second start of a job whose process died; doubled for the third."""
MAX_DOUBLINGS: Final = 6
"""How often that is doubled after interruptions in a row."""
LOG_INTERVAL: Final = 30.0
"""Seconds between two complaints about a database that does not answer."""
READ_ONLY: Final = "25006"
"""What PostgreSQL says while it only reads, as one does that is about to take over from another (SQLSTATE)."""

T = TypeVar("T")
_R = ReconstructionState
_log = logging.getLogger(__name__)


class JobRunner:
    """Runner of jobs, one at a time, in child processes that are reused by kind.

    Parameters
    ----------
    commands
        Command of the child process for each job kind; kinds with the same command share a child.
    worker
        Name of this worker, for the history.
    """

    def __init__(
        self, settings: Settings, ledger: JobLedger, commands: Mapping[str, Sequence[str]], worker: str
    ) -> None:
        self.stopping, self.idle, self.ended = SignalSafeEvent(), threading.Event(), threading.Event()
        self.idle.set()
        self._settings, self._ledger, self._worker = settings, ledger, worker
        self._data, self._keeper = DataDirectory(settings.data), ResultUploader(settings, ledger.database)
        self._identity = self._data.identity
        threads = str(settings.threads_per_job)
        limits = dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"), threads)
        environment = settings.environment(keys=False) | limits
        processes = {tuple(command): JobProcess(command, environment) for command in commands.values()}
        self._processes = {kind: processes[tuple(command)] for kind, command in commands.items()}
        self._ended, self._asked_to_end = float("-inf"), float("inf")

    @property
    def is_hurried(self) -> bool:
        """Whether a job ended less than :data:`FAST_POLL_WINDOW` ago, so that the queue is polled fast."""
        return self.idle.is_set() and time.monotonic() - self._ended < FAST_POLL_WINDOW

    async def run(self, job_id: str) -> str:
        """Run attempts of a job until it reaches a terminal state or another worker has it; return the state."""
        self.idle.clear()
        row, interruptions = None, 0
        try:
            while True:
                if interruptions:
                    await self._until_writable()
                if self._folder_is_lost or self.stopping.is_set():
                    await self._idle_until_stopped()
                after = self._data.job(job_id).latest_attempt
                row = await self._retry_transient(partial(self._ledger.start_attempt, job_id, self._worker, after))
                request_id.set(row.request_id or "")  # of this task alone
                if row.state is _R.RUNNING:
                    row = await self._attempt(row)
                if row.state is not _R.QUEUED:
                    return row.state
                interrupted = row.attempts[-1]["outcome"] == "interrupted"
                interruptions = interruptions + 1 if interrupted else 0
                await self._rest(BACKOFF * 2 ** (min(interruptions, MAX_DOUBLINGS) if interrupted else row.attempt - 1))
        except StaleFence as error:
            _log.warning("%s; another worker has it", error)
            return _R.RUNNING
        except NotFound as error:
            _log.warning("%s any more; its result is discarded", error)
            return _R.CANCELLED
        except asyncio.CancelledError:
            # The engine ends a cancelled step at any of its waits, perhaps before that was written down.
            with suppress(StaleFence, SQLAlchemyError):
                self._ledger.cancelled(job_id, self._worker, None if row is None else row.fence)
            raise
        finally:
            self._ended = time.monotonic()
            self.idle.set()
            self.ended.set()
            gc.collect()  # what the job left, while the engine looks for the next

    async def _attempt(self, row: JobRow) -> JobRow:
        """Run one attempt of a job and record its outcome, also after an error."""
        process = self._processes.get(row.kind)
        if process is None:
            return await self._finish(row, Failed("unknown-kind", f"no worker runs jobs of kind {row.kind!r}"))
        job = asyncio.ensure_future(self._run_in_child(process, row, progress := _Progress(self, row)))
        try:
            while not job.done():
                await asyncio.wait({job}, timeout=POLL)
                if job.done():
                    break
                if self._must_end:
                    await _kill(job)
                    await self._put_back(row, "the worker was stopped")
                await progress.pass_on()
                if await self._should_stop(row):
                    await _kill(job)
                    return await self._cancelled(row)
            outcome = job.result()
            if not isinstance(outcome, Succeeded) and self._folder_is_lost:
                await self._put_back(row, f"the data folder was gone: {outcome.message}")
            return await self._finish(row, outcome)
        finally:
            await _kill(job)

    @property
    def _must_end(self) -> bool:
        """Whether the worker was stopped and its drain period for the running job has passed."""
        if not self.stopping.is_set():
            return False
        self._asked_to_end = min(self._asked_to_end, time.monotonic())
        return time.monotonic() - self._asked_to_end >= self._settings.drain_seconds

    @property
    def _folder_is_lost(self) -> bool:
        """Whether the data folder is no longer mounted; the worker then stops.

        The next worker process on this host waits for the folder; meanwhile workers of other hosts run the jobs.
        """
        if self._data.identity == self._identity:
            return False
        if not self.stopping.is_set():
            _log.error("the data folder %s is gone; is it mounted? This worker ends", self._data.root)
            self.stopping.set()
        return True

    async def _put_back(self, row: JobRow, why: str) -> None:
        await self._retry_transient(lambda: self._ledger.requeue(row.id, row.fence, self._worker, why))
        await self._idle_until_stopped()

    async def _run_in_child(self, process: JobProcess, row: JobRow, progress: _Progress) -> Outcome:
        folder = self._data.job(row.id)
        about = {"kind": row.kind, "request": row.payload, "principal": row.history[0]["who"], "start": row.fence}
        about |= {"job": str(folder.root), "data": str(self._data.root.absolute()), "store": bool(self._settings.store)}
        timeout = min(row.timeout or self._settings.job_timeout, self._settings.job_timeout)
        follows = JOB_TYPES[row.kind].follows if row.kind in JOB_TYPES and row.timeout is None else None
        if (why := unwritable_jobs(self._data)) is not None:
            return Requeued(f"waits until its folder can be written: {why}")
        if (why := unwritable_job(self._data, row.id)) is not None:
            return Failed("folder-not-writable", f"its folder cannot be written: {why}")
        try:
            outcome = await process.run(about, log=folder.log, report=progress, timeout=timeout, follows=follows)
            return self._keeper.with_commit(outcome)
        except OSError as error:
            return Requeued(f"the job's process cannot be run: {error}")
        except Exception as error:
            _log.exception("job %s: its process sent an invalid message", row.id)
            return Crashed(f"its process sent an invalid message: {error}")

    async def _finish(self, row: JobRow, outcome: Outcome) -> JobRow:
        if not isinstance(outcome, Succeeded):
            _log.warning("job %s: %s", row.id, outcome.message)
            self._note(row.id, outcome.message)
        try:
            await asyncio.to_thread(self._keeper.upload_log_and_remove, row.id, row.fence, self._data.job(row.id))
            finish = partial(self._ledger.finish_attempt, row.id, row.fence, outcome, self._worker)
            return await self._retry_transient(finish)
        except StoreUnavailable as error:  # which had all of it a moment ago
            return await self._finish(row, Requeued(str(error)))
        except DBAPIError as error:
            if isinstance(outcome, Failed):
                raise
            return await self._finish(row, Failed("internal", f"the database rejects its result: {error.orig}"))

    async def _cancelled(self, row: JobRow) -> JobRow:
        await asyncio.to_thread(self._keeper.upload_log_and_remove, row.id, row.fence, self._data.job(row.id))
        return await self._retry_transient(lambda: self._ledger.cancelled(row.id, self._worker, row.fence))

    def _note(self, job_id: str, text: str) -> None:
        """Append a line of the worker to the job's log file, ignoring write errors."""
        path = self._data.job(job_id).log
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("a") as log:
                log.write(f"{self._worker}: {text}{request_id_suffix()}\n")
        except OSError as error:
            _log.warning("the log of job %s cannot be written: %s", job_id, error)

    async def _should_stop(self, row: JobRow) -> bool:
        """Return whether cancellation was requested; raises :class:`StaleFence` when there is a newer attempt."""
        try:
            state, fence = await asyncio.to_thread(self._ledger.state_and_fence, row.id)
        except SQLAlchemyError:
            return False  # asked again soon
        if fence != row.fence:
            raise StaleFence(f"start {row.fence} of job {row.id} counts no more; start {fence} has begun")
        return state in {_R.CANCELLING, _R.CANCELLED}

    async def report(self, row: JobRow, stage: str, done: int, total: int) -> None:
        """Store the progress of a job in the ledger, ignoring errors, because newer progress follows."""
        try:
            await asyncio.to_thread(self._ledger.report, row.id, row.fence, stage, done, total)
        except StaleFence:
            return  # as the next look says
        except SQLAlchemyError as error:
            _log.warning("progress of job %s is lost: %s", row.id, error)

    async def _rest(self, seconds: float) -> None:
        """Sleep before the next attempt (backoff); does not return if the worker is stopped meanwhile."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            if self.stopping.is_set():
                await self._idle_until_stopped()
            await asyncio.sleep(min(left, POLL))

    async def _until_writable(self) -> None:
        """Wait until the folder of jobs is writable, polling it."""
        while unwritable_jobs(self._data) is not None and not self._folder_is_lost:
            await self._rest(BACKOFF)

    async def _idle_until_stopped(self) -> None:
        """Mark the worker as idle and block until its process exits, so that the engine does not see the job end."""
        self.idle.set()
        await asyncio.Event().wait()

    async def _retry_transient(self, change: Callable[[], T]) -> T:
        """Run a ledger update, retrying while the database is unavailable or the disk is full.

        Permanent database errors are raised.
        """
        told = float("-inf")
        while True:
            try:
                return await asyncio.to_thread(change)
            except SQLAlchemyError as error:
                if not _is_transient(error):
                    raise
                if time.monotonic() - told > LOG_INTERVAL:
                    told = time.monotonic()
                    _log.warning("the database does not accept a job's result; retrying: %s", error)
                await asyncio.sleep(0.5)


def _is_transient(error: SQLAlchemyError) -> bool:
    """Return whether a database error is transient: unavailable, busy, full, read-only, or a concurrent change."""
    if isinstance(error, DBAPIError):
        only_reads = getattr(error.orig, "sqlstate", None) == READ_ONLY
        return only_reads or error.connection_invalidated or isinstance(error, OperationalError | InterfaceError)
    return isinstance(error, NoConnection | StaleDataError)


class _Progress:
    """Rate limiter of progress reports: at most one every :data:`POLL` seconds, the newest first."""

    def __init__(self, runner: JobRunner, row: JobRow) -> None:
        self._runner, self._row, self._when = runner, row, float("-inf")
        self._newest: tuple[str, int, int] | None = None

    async def __call__(self, stage: str, done: int, total: int) -> None:
        self._newest = (stage, done, total)
        await self.pass_on()

    async def pass_on(self) -> None:
        """Report the pending progress if the interval has passed."""
        if self._newest is None or time.monotonic() - self._when < POLL:
            return
        self._when, newest, self._newest = time.monotonic(), self._newest, None
        await self._runner.report(self._row, *newest)


async def _kill(job: asyncio.Future[Any]) -> None:
    job.cancel()
    await asyncio.wait({job})
