"""What a worker does with a job that the engine gave it: attempts, progress, cancelling, putting back."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeVar

from sqlalchemy.exc import DBAPIError

from steradian.settings import Settings
from steradian.storage.job_ledger import JobLedger
from steradian.storage.job_process import JobProcess
from steradian.storage.jobs import Died, Failed, Succeeded
from steradian.storage.paths import DataDirectory
from steradian.storage.states import ReconstructionState
from steradian.storage.tables import JobRow

POLL: Final = 0.2
"""Seconds between looks at a cancellation and between progress reports."""
BACKOFF: Final = 0.5
"""Seconds before the second start of a job whose process died; doubled for the third."""
PATIENCE: Final = 120.0
"""Seconds for which a database that does not answer is asked again."""

T = TypeVar("T")
_R = ReconstructionState
_log = logging.getLogger(__name__)


class JobRunner:
    """Runs one job at a time, each in the child process that is kept for its kind.

    Parameters
    ----------
    commands
        The program that runs each kind of job.
    worker
        Name of this worker, for the history.
    """

    def __init__(
        self, settings: Settings, ledger: JobLedger, commands: Mapping[str, Sequence[str]], worker: str
    ) -> None:
        self.stopping, self.idle = threading.Event(), threading.Event()
        self.idle.set()
        self._settings, self._ledger, self._worker = settings, ledger, worker
        self._data = DataDirectory(settings.data)
        threads = str(settings.threads_per_job)
        limits = dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"), threads)
        environment = settings.environment() | limits
        self._processes = {kind: JobProcess(command, environment) for kind, command in commands.items()}

    async def run(self, job_id: str) -> str:
        """Attempt a job until it is over; returns its state."""
        self.idle.clear()
        try:
            while True:
                row = await self._patiently(lambda: self._ledger.start(job_id, self._worker))
                if row.state is _R.RUNNING:
                    row = await self._attempt(row)
                if row.state is not _R.QUEUED:
                    return row.state
                await asyncio.sleep(BACKOFF * 2 ** (row.attempt - 1))
        except asyncio.CancelledError:
            # The engine ends a cancelled step at any of its waits, perhaps before that was written down.
            self._ledger.cancelled(job_id, self._worker)
            raise
        finally:
            self.idle.set()

    async def _attempt(self, row: JobRow) -> JobRow:
        process = self._processes.get(row.kind)
        if process is None:
            refusal = Failed("unknown-kind", f"no worker runs jobs of kind {row.kind!r}")
            return await self._settle(row.id, refusal)
        folder = self._data.job(row.id)
        job = asyncio.ensure_future(
            process.run(
                row.payload | {"job": str(folder.root), "data": str(self._data.root.absolute())},
                log=folder.log,
                report=_Progress(self, row.id),
                timeout=min(row.timeout or self._settings.job_timeout, self._settings.job_timeout),
            )
        )
        try:
            while not job.done():
                await asyncio.wait({job}, timeout=POLL)
                if job.done():
                    break
                if self.stopping.is_set():
                    await _kill(job)
                    await self._patiently(lambda: self._ledger.put_back(row.id, self._worker))
                    self.idle.set()
                    await asyncio.Event().wait()  # the process ends first
                if await self._is_unwanted(row.id):
                    await _kill(job)
                    return await self._patiently(lambda: self._ledger.cancelled(row.id, self._worker))
            return await self._settle(row.id, job.result())
        finally:
            await _kill(job)

    async def _settle(self, job_id: str, outcome: Succeeded | Failed | Died) -> JobRow:
        if not isinstance(outcome, Succeeded):
            _log.warning("job %s: %s", job_id, outcome.message)
            self._note(job_id, outcome.message)
        return await self._patiently(lambda: self._ledger.settle(job_id, outcome, self._worker))

    def _note(self, job_id: str, text: str) -> None:
        """Add a line of the worker's own to the job's log."""
        path = self._data.job(job_id).log
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a") as log:
            log.write(f"{self._worker}: {text}\n")

    async def _is_unwanted(self, job_id: str) -> bool:
        try:
            state = (await asyncio.to_thread(self._ledger.get, job_id)).state
        except DBAPIError:
            return False  # asked again soon
        return state in {_R.CANCELLING, _R.CANCELLED}

    async def report(self, job_id: str, stage: str, done: int, total: int) -> None:
        """Pass progress on; one that is lost is replaced by the next."""
        try:
            await asyncio.to_thread(self._ledger.report, job_id, stage, done, total)
        except DBAPIError as error:
            _log.warning("progress of job %s is lost: %s", job_id, error.orig)

    async def _patiently(self, change: Callable[[], T]) -> T:
        """Change the ledger, also when its database comes back only after a while."""
        deadline = time.monotonic() + PATIENCE
        while True:
            try:
                return await asyncio.to_thread(change)
            except DBAPIError:
                if time.monotonic() > deadline:
                    raise
                await asyncio.sleep(0.5)


class _Progress:
    """Passes on progress at most every :data:`POLL` seconds, but every new stage and every end of one."""

    def __init__(self, runner: JobRunner, job_id: str) -> None:
        self._runner, self._id, self._stage, self._when = runner, job_id, "", float("-inf")

    async def __call__(self, stage: str, done: int, total: int) -> None:
        now = time.monotonic()
        if stage == self._stage and done < total and now - self._when < POLL:
            return
        self._stage, self._when = stage, now
        await self._runner.report(self._id, stage, done, total)


async def _kill(job: asyncio.Future[Any]) -> None:
    job.cancel()
    await asyncio.wait({job})
