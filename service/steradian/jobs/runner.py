"""What a worker does with a job that the engine gave it: attempts, progress, cancelling, putting back."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeVar

from sqlalchemy.exc import DBAPIError

from steradian.jobs.ledger import JobLedger
from steradian.jobs.model import Died, Failed, Succeeded
from steradian.jobs.process import JobProcess
from steradian.settings import Settings
from steradian.stopping import StopEvent
from steradian.storage.paths import DataDirectory
from steradian.storage.states import ReconstructionState
from steradian.storage.tables import JobRow

POLL: Final = 0.2
"""Seconds between looks at a cancellation and between progress reports."""
HURRY: Final = 0.5
"""Seconds after a job's end for which the next one is looked for almost without a pause."""
HURRIED_POLL: Final = 0.01
"""That pause."""
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
        The program that runs each kind of job; kinds of the same program share its process.
    worker
        Name of this worker, for the history.
    """

    def __init__(
        self, settings: Settings, ledger: JobLedger, commands: Mapping[str, Sequence[str]], worker: str
    ) -> None:
        self.stopping, self.idle, self.ended = StopEvent(), threading.Event(), threading.Event()
        self.idle.set()
        self._settings, self._ledger, self._worker = settings, ledger, worker
        self._data = DataDirectory(settings.data)
        threads = str(settings.threads_per_job)
        limits = dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"), threads)
        environment = settings.environment() | limits
        processes = {tuple(command): JobProcess(command, environment) for command in commands.values()}
        self._processes = {kind: processes[tuple(command)] for kind, command in commands.items()}
        self._ended = float("-inf")

    @property
    def is_hurried(self) -> bool:
        """Whether a job has just ended and the next one is wanted at once."""
        return self.idle.is_set() and time.monotonic() - self._ended < HURRY

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
            self._ended = time.monotonic()
            self.idle.set()
            self.ended.set()

    async def _attempt(self, row: JobRow) -> JobRow:
        process = self._processes.get(row.kind)
        if process is None:
            refusal = Failed("unknown-kind", f"no worker runs jobs of kind {row.kind!r}")
            return await self._settle(row.id, refusal)
        folder, progress = self._data.job(row.id), _Progress(self, row.id)
        about = {"kind": row.kind, "request": row.payload, "principal": row.history[0]["who"]}
        where = {"job": str(folder.root), "data": str(self._data.root.absolute())}
        job = asyncio.ensure_future(
            process.run(
                about | where,
                log=folder.log,
                report=progress,
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
                await progress.pass_on()
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
            state = await asyncio.to_thread(self._ledger.state, job_id)
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


def hurried(event: threading.Event, runner: JobRunner, poll: float) -> Callable[[float | None], bool]:
    """Make a wait for ``event`` that ends early after a job's end, so that the next one is looked for at once.

    The engine looks at the queue every ``poll`` seconds and waits between two looks for the event that says when to
    stop; longer waits are left as they are.
    """
    plain = event.wait

    def wait(timeout: float | None = None) -> bool:
        if timeout is None or timeout > 2 * poll:
            return plain(timeout)
        if runner.is_hurried:
            return plain(min(HURRIED_POLL, timeout))
        if runner.ended.wait(timeout):
            runner.ended.clear()
        return event.is_set()

    return wait


class _Progress:
    """Passes on progress at most every :data:`POLL` seconds: at once, or the newest when its turn has come."""

    def __init__(self, runner: JobRunner, job_id: str) -> None:
        self._runner, self._id, self._when = runner, job_id, float("-inf")
        self._newest: tuple[str, int, int] | None = None

    async def __call__(self, stage: str, done: int, total: int) -> None:
        self._newest = (stage, done, total)
        await self.pass_on()

    async def pass_on(self) -> None:
        """Report what has not been reported, if it is time."""
        if self._newest is None or time.monotonic() - self._when < POLL:
            return
        self._when, newest, self._newest = time.monotonic(), self._newest, None
        await self._runner.report(self._id, *newest)


async def _kill(job: asyncio.Future[Any]) -> None:
    job.cancel()
    await asyncio.wait({job})
