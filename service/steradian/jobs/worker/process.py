"""Protocol between worker and job subprocess, both ends (JSON lines over pipes).

The child reads each job as one JSON line from standard input, which stays open: when it closes, the worker is gone and
the child ends at once. It writes JSON lines: ``{"begun"}``, ``{"stage", "done", "total"}`` on the way and at last
``{"result", "last"}``, ``{"error": {"code", "message"}}`` or ``{"interrupted"}``. What a job writes elsewhere goes to
its log.

A child stays for the next job only after a success, because loading the numerics takes seconds. Cancelling, a timeout
and any failure end the process, so what they hit is one job and its memory.
"""

from __future__ import annotations

import asyncio
import errno
import gc
import json
import logging
import os
import queue
import sys
import threading
from asyncio.subprocess import PIPE, Process
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, TypeAlias

from steradian.core.child_process import describe_exit
from steradian.core.exceptions import DiskFull, StaleFence, SteradianError, StoreUnavailable
from steradian.core.logging_config import request_id
from steradian.core.progress import Progress
from steradian.core.sandbox import set_oom_score
from steradian.jobs.job import Crashed, Failed, Outcome, Requeued, Succeeded
from steradian.storage.data_dir.job_directory import StillRunning

Report: TypeAlias = Callable[[str, int, int], Awaitable[None]]
"""Called by the worker with each stage, done and total that the child reports."""

LINE_LIMIT = 16 * 2**20
MAX_JOBS = 50
"""Jobs after which a child is replaced."""
MAX_RESIDENT = 2 * 2**30
"""Bytes that a child may hold between jobs; one that holds more is replaced."""
DISK_FULL = {errno.ENOSPC, errno.EDQUOT}
"""System errors of a disk without space."""
CRASHED = {errno.EIO, errno.ESTALE, errno.ENOTCONN, errno.ENODEV, errno.ENXIO, errno.ETIMEDOUT, errno.EHOSTDOWN}
"""What the system says of a file system that is gone."""
OOM_SCORE = 500
"""By how much sooner the kernel ends a job than the service when memory runs out; a stranger's file goes first."""
NICENESS = 5
"""By how much a job stands back where processors are short: who answers requests and who scans comes first."""
IDLE_TIMEOUT = 600.0
"""Seconds after which a child without work ends."""
_log = logging.getLogger(__name__)
_NO_CHARACTERS = dict.fromkeys([0, *range(0xD800, 0xE000)], "\N{REPLACEMENT CHARACTER}")
"""NUL and halves of surrogate pairs, which names in a stranger's file may hold."""


class JobProcess:
    """Reusable child process that runs jobs, seen from the worker; restarted after a failed job."""

    def __init__(self, command: Sequence[str], environment: Mapping[str, str]) -> None:
        self._command, self._environment = command, environment
        self._child: Process | None = None

    async def run(
        self,
        payload: Mapping[str, Any],
        *,
        log: Path,
        report: Report,
        timeout: float,  # noqa: ASYNC109 - it ends a process, not only the waiting
        follows: str | None = None,
    ) -> Outcome:
        """Run a job in the child process and return its outcome; cancelling this coroutine kills the child.

        Parameters
        ----------
        timeout
            Seconds after which the child is killed and the job has failed.
        follows
            Stage whose reports restart the timeout, because its duration is that of a scan.
        """
        log.parent.mkdir(parents=True, exist_ok=True)
        outcome: Outcome | None = None
        try:
            async with asyncio.timeout(timeout) as limit:

                async def heard(stage: str, done: int, total: int) -> None:
                    if stage == follows:
                        limit.reschedule(asyncio.get_running_loop().time() + timeout)
                    await report(stage, done, total)

                while outcome is None:
                    job = {"log": str(log), "payload": dict(payload), "request_id": request_id.get()}
                    outcome = await self._converse(job, heard)
        except TimeoutError:
            outcome = Failed("timeout", f"the job did not end within {timeout:g} s")
        finally:
            if not isinstance(outcome, Succeeded):
                await self.end()
        return outcome

    async def end(self) -> None:
        """Kill the child process, if there is one, and wait until it has ended."""
        child, self._child = self._child, None
        if child is None:
            return
        if child.returncode is None:
            with suppress(ProcessLookupError):
                child.kill()
        await asyncio.shield(asyncio.ensure_future(child.wait()))
        if child.stdin is not None:
            child.stdin.close()

    async def _converse(self, request: dict[str, Any], report: Report) -> Outcome | None:
        """Send a job to the child and return its outcome; ``None`` if a reused child ended before the job began."""
        kept = self._child is not None
        child = self._child = self._child or await self._start()
        assert child.stdin is not None  # noqa: S101 - asked for in _start
        assert child.stdout is not None  # noqa: S101
        with suppress(ConnectionError):
            child.stdin.write(json.dumps(request).encode() + b"\n")
            await child.stdin.drain()
        begun = False
        async for line in child.stdout:
            match _parse(line):
                case {"begun": True}:
                    begun = True
                case {"stage": str(stage), "done": int(done), "total": int(total)}:
                    await report(stage, done, total)
                case {"result": dict(result), "last": bool(last)}:
                    if last:
                        await self.end()
                    return Succeeded(result)
                case {"error": {"code": str(kind), "message": str(message)}}:
                    return Failed(kind, message)
                case {"interrupted": str(message)}:
                    return Requeued(message)
                case _:
                    pass
        code = await child.wait()
        await self.end()
        if kept and not begun:
            return None
        return Crashed(f"the job's process ended {describe_exit(code)} without a result")

    async def _start(self) -> Process:
        """Start the child process; on cancellation meanwhile, store it so that it can be killed."""
        starting = asyncio.ensure_future(
            asyncio.create_subprocess_exec(
                *self._command, stdin=PIPE, stdout=PIPE, env=self._environment, limit=LINE_LIMIT
            )
        )
        try:
            return await asyncio.shield(starting)
        except asyncio.CancelledError:
            self._child = await starting
            raise


def _parse(line: bytes) -> object:
    with suppress(ValueError):
        return json.loads(line)
    return None


def child_main(work: Callable[[dict[str, Any], Progress], dict[str, Any]]) -> None:
    """Run the main loop of the child process: read jobs from standard input, call ``work``, write the results.

    Returns on end of input or failure or when idle.

    An error of our own tree is reported and final; any other is reported with its type, its traceback in the log,
    and counts as deterministic too. What is no fault of the job (a lost database or folder, an earlier start that is
    still at it) is an interruption.
    """
    set_oom_score(OOM_SCORE)
    os.nice(NICENESS)
    speak = _MessageWriter()
    jobs: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    threading.Thread(target=_read_jobs, args=(jobs,), daemon=True).start()
    for number in range(1, MAX_JOBS + 1):
        try:
            job = jobs.get(timeout=IDLE_TIMEOUT)
        except queue.Empty:
            return
        speak(begun=True)
        _log_to(job["log"])
        request_id.set(job["request_id"])
        result = _do(work, job["payload"], speak)
        if result is None:
            return
        speak(result=result, last=number == MAX_JOBS or _resident() > MAX_RESIDENT)
        gc.collect()  # while the worker fetches the next job
        if number == 1:
            gc.freeze()  # the libraries stay; later collections need not look at them


def _do(
    work: Callable[[dict[str, Any], Progress], dict[str, Any]], payload: dict[str, Any], speak: _MessageWriter
) -> dict[str, Any] | None:
    try:
        return work(payload, lambda stage, done, total: speak(stage=stage, done=int(done), total=int(total)))
    except (StillRunning, StaleFence, StoreUnavailable) as error:
        speak(interrupted=str(error))
    except SteradianError as error:
        speak(error={"code": error.code, "message": _for_clients(str(error), payload)})
    except MemoryError:
        speak(error={"code": "out-of-memory", "message": "the job needs more memory than there is"})
    except Exception as error:
        _log.exception("the job failed")
        message = _for_clients(f"{type(error).__name__}: {error}", payload)
        if _is_interruption(error):
            speak(interrupted=message)
        elif isinstance(error, OSError) and error.errno in DISK_FULL:
            speak(error={"code": DiskFull.code, "message": message})
        else:
            speak(error={"code": "internal", "message": message})
    return None


def _for_clients(message: str, payload: dict[str, Any]) -> str:
    """Remove the data folder's path and unstorable characters from an error message for clients."""
    return message.replace(f"{payload.get('data')}/", "").translate(_NO_CHARACTERS)


def _is_interruption(error: Exception) -> bool:
    """Return whether an exception comes from a database or file system failure and not from the job."""
    if isinstance(error, OSError):
        return error.errno in CRASHED
    databases = sys.modules.get("sqlalchemy.exc")
    return databases is not None and isinstance(error, (databases.OperationalError, databases.InterfaceError))


def _read_jobs(jobs: queue.SimpleQueue[dict[str, Any]]) -> None:
    """Read jobs from standard input into a queue; exit the process at end of file."""
    for line in sys.stdin:
        jobs.put(json.loads(line))
    os._exit(70)


def _log_to(path: str) -> None:
    """Redirect standard output and standard error to a job's log file, on the level of file descriptors."""
    sys.stderr.flush()
    with open(path, "ab") as log:
        os.dup2(log.fileno(), 1)
        os.dup2(log.fileno(), 2)


def _resident() -> int:
    """Return the resident memory of this process in bytes; 0 where the system does not report it."""
    with suppress(OSError, ValueError):
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return 0


class _MessageWriter:
    """Thread-safe writer of JSON lines to the worker; other standard output goes to the log."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._pipe: IO[str] = os.fdopen(os.dup(1), "w")
        os.dup2(2, 1)

    def __call__(self, **message: Any) -> None:
        with self._lock:
            self._pipe.write(json.dumps(message) + "\n")
            self._pipe.flush()
