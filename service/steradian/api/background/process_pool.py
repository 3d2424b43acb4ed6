"""Pool of subprocesses for CPU-bound work with a CPU-time limit and idle reaping.

Threads would not suffice: Python code that computes, such as a parser of a large document, blocks all other threads of
its process. Calls and results are pickled and sent through the pipes of a child that ends when its input closes.
"""

from __future__ import annotations

import asyncio
import contextvars
import logging
import math
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any, ParamSpec, TypeVar, cast

from steradian.core.exceptions import SteradianError

POOL_SIZE = 3
"""Things worked out at a time, two pictures at most among them; the rest waits in line."""
IDLE = 60.0
"""Seconds after which a child without work is ended, and its memory free."""
CPU_SECONDS = 120
"""Seconds of a processor that one thing may take, which is the same however busy the machine is."""
MAX_SECONDS = 1800.0
"""Longest that it may take, waiting included."""
CPU_LIMIT_EXIT = -getattr(signal, "SIGXCPU", 24)
"""How a child ends that has worked too long."""
NICENESS = 5
_P = ParamSpec("_P")
_T = TypeVar("_T")
_log = logging.getLogger(__name__)


class ComputationLimitExceeded(SteradianError):
    """Error: a call in the process pool exceeded its limit of time or memory, or its process died."""

    code = "too-expensive"


class ProcessPool:
    """Process pool: executes importable functions with picklable arguments in subprocesses.

    Parameters
    ----------
    max_work
        CPU time limit of a call in seconds.
    """

    def __init__(self, max_work: int = CPU_SECONDS) -> None:
        self._max_work = max_work
        self._hands = ThreadPoolExecutor(POOL_SIZE, "process-pool")
        self._idle: list[_PoolProcess] = []
        self._busy: set[_PoolProcess] = set()
        self._guard = threading.Lock()
        self._over = False

    async def submit(self, function: Callable[_P, _T], *args: _P.args, **options: _P.kwargs) -> _T:
        """Execute a function in a pool process and return its result, or raise its exception.

        Raises
        ------
        ComputationLimitExceeded
            When the process that worked on it died or was ended, or took too long.
        """
        if self._over:
            raise ComputationLimitExceeded("the service ends")
        call = pickle.dumps((self._max_work, function, args, options), pickle.HIGHEST_PROTOCOL)
        converse = contextvars.copy_context().run  # so that what it logs bears the request
        answer = await asyncio.get_running_loop().run_in_executor(self._hands, converse, self._converse, call)
        raised, value = await asyncio.to_thread(pickle.loads, answer)
        if raised:
            raise value
        return cast(_T, value)

    def reap_idle(self) -> None:
        """Terminate the subprocesses that have been idle for :data:`IDLE` seconds."""
        with self._guard:
            old = [child for child in self._idle if time.monotonic() - child.since > IDLE]
            self._idle = [child for child in self._idle if child not in old]
        for child in old:
            child.end()

    def close(self) -> None:
        """Terminate all pool processes; pending calls raise :class:`ComputationLimitExceeded`."""
        self._over = True
        self._hands.shutdown(wait=False, cancel_futures=True)
        with self._guard:
            idle, self._idle = self._idle, []
            for child in self._busy:
                child.kill()  # the thread that waits for its answer does the rest
        for child in idle:
            child.end()

    def _converse(self, call: bytes) -> bytes:
        child = self._take()
        try:
            answer = child.answer(call)
        except BaseException:
            self._put_back(child, is_well=False)
            raise
        self._put_back(child, is_well=True)
        return answer

    def _take(self) -> _PoolProcess:
        with self._guard:
            if self._over:
                raise ComputationLimitExceeded("the service ends")
            child = self._idle.pop() if self._idle else _PoolProcess()
            self._busy.add(child)
            return child

    def _put_back(self, child: _PoolProcess, *, is_well: bool) -> None:
        child.since = time.monotonic()
        with self._guard:
            self._busy.remove(child)
            if is_well and not self._over:
                self._idle.append(child)
                return
        child.end()


class _PoolProcess:
    """Subprocess of the pool, which executes one call after another."""

    def __init__(self) -> None:
        command = [sys.executable, "-P", "-m", __spec__.name]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.since = time.monotonic()

    def answer(self, call: bytes) -> bytes:
        """Execute a pickled call in the subprocess and return its pickled result, within limits of time and memory."""
        assert self._process.stdin is not None  # noqa: S101 - asked for
        assert self._process.stdout is not None  # noqa: S101
        patience = threading.Timer(MAX_SECONDS, self._process.kill)
        patience.start()
        try:
            self._process.stdin.write(len(call).to_bytes(8, "big") + call)
            self._process.stdin.flush()
            size = self._process.stdout.read(8)
            answer = self._process.stdout.read(int.from_bytes(size, "big")) if len(size) == 8 else b""
            if answer:
                return answer
        except OSError as error:
            _log.warning("a process of the pool has ended: %s", error)
        finally:
            patience.cancel()
        self._process.kill()
        if self._process.wait() == CPU_LIMIT_EXIT:
            raise ComputationLimitExceeded("it took longer than it may")
        raise ComputationLimitExceeded(
            f"it took more memory than there is, or more than {MAX_SECONDS:g} s, or the service ends"
        )

    def kill(self) -> None:
        """Kill the subprocess; its current call fails."""
        self._process.kill()

    def end(self) -> None:
        """Kill the subprocess, wait until it has ended and close its pipes."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError):
                assert pipe is not None  # noqa: S101 - asked for
                pipe.close()


def main() -> None:
    """Execute pickled calls from standard input and write their results, until standard input closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(NICENESS)
    calls, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    while len(size := calls.read(8)) == 8:
        answer = _answer(calls.read(int.from_bytes(size, "big")))
        answers.write(len(answer).to_bytes(8, "big") + answer)
        answers.flush()


def _end_after(seconds: int) -> None:
    """Set the kernel's CPU time limit of this process, counted from now."""
    if sys.platform == "win32":
        return
    import resource

    worked = resource.getrusage(resource.RUSAGE_SELF)
    hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
    limit = math.ceil(worked.ru_utime + worked.ru_stime) + seconds
    resource.setrlimit(resource.RLIMIT_CPU, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))


def _answer(call: bytes) -> bytes:
    try:
        max_work, function, args, options = pickle.loads(call)  # noqa: S301 - our parent wrote it
        _end_after(max_work)
        found: tuple[bool, Any] = False, function(*args, **options)
    except Exception as error:
        found = True, error
    try:
        return pickle.dumps(found, pickle.HIGHEST_PROTOCOL)
    except Exception:
        return pickle.dumps((True, RuntimeError(f"{type(found[1]).__name__}: {found[1]}")))


if __name__ == "__main__":
    main()
