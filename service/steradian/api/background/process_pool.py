"""Pool of subprocesses for CPU-bound work with a CPU-time limit and idle reaping.

Threads would not suffice: Python code that computes, such as a parser of a large document, blocks all other threads of
its process.
"""

from __future__ import annotations

import asyncio
import contextvars
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import ParamSpec, TypeVar

from steradian.core.child_process import CallProcess, ChildExited
from steradian.core.exceptions import SteradianError

POOL_SIZE = 4
"""Calls executed at a time, at most two pictures and one design among them; further calls wait in line."""
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

        When the task that waits for it is cancelled, the pool process is killed.

        Raises
        ------
        ComputationLimitExceeded
            When the process that worked on it died or was ended, or took too long.
        """
        if self._over:
            raise ComputationLimitExceeded("the service ends")
        run = contextvars.copy_context().run  # so that log lines have the request identifier
        call = partial(function, *args, **options)
        state = _CallState()
        try:
            return await asyncio.get_running_loop().run_in_executor(self._hands, run, self._call, call, state)
        except asyncio.CancelledError:
            self._cancel(state)
            raise

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

    def _cancel(self, state: _CallState) -> None:
        with self._guard:
            state.is_cancelled = True
            if state.child is not None:
                state.child.kill()  # the thread that waits for its answer does the rest

    def _call(self, function: Callable[[], _T], state: _CallState) -> _T:
        child = self._take(state)
        patience = threading.Timer(MAX_SECONDS, child.kill)
        patience.start()
        is_well = True
        try:
            return child.call(_run_limited, self._max_work, function)
        except ChildExited as error:
            is_well = False
            if error.status == CPU_LIMIT_EXIT:
                raise ComputationLimitExceeded("it took longer than it may") from error
            limits = f"it took more memory than there is, or more than {MAX_SECONDS:g} s, or the service ends"
            raise ComputationLimitExceeded(limits) from error
        finally:
            patience.cancel()
            self._put_back(child, state, is_well=is_well)

    def _take(self, state: _CallState) -> _PoolProcess:
        with self._guard:
            if self._over:
                raise ComputationLimitExceeded("the service ends")
            if state.is_cancelled:
                raise ComputationLimitExceeded("it was cancelled")
            child = self._idle.pop() if self._idle else _PoolProcess()
            self._busy.add(child)
            state.child = child
            return child

    def _put_back(self, child: _PoolProcess, state: _CallState, *, is_well: bool) -> None:
        child.since = time.monotonic()
        with self._guard:
            self._busy.remove(child)
            state.child = None
            if is_well and not self._over and not state.is_cancelled:
                self._idle.append(child)
                return
        child.end()


class _PoolProcess(CallProcess):
    """Process of the pool, with the time since which it is idle."""

    since = 0.0


class _CallState:
    """State of one call: the process that executes it, and whether the task that waits for it was cancelled."""

    child: _PoolProcess | None = None
    is_cancelled = False


def _run_limited(seconds: int, function: Callable[[], _T]) -> _T:
    """Run a function in a process of the pool, with lower priority and a CPU time limit."""
    if sys.platform != "win32":
        os.setpriority(os.PRIO_PROCESS, 0, max(NICENESS, os.getpriority(os.PRIO_PROCESS, 0)))
        _limit_cpu_time(seconds)
    return function()


def _limit_cpu_time(seconds: int) -> None:
    """Set the kernel's CPU time limit of this process, counted from now."""
    import resource

    used = resource.getrusage(resource.RUSAGE_SELF)
    hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
    limit = math.ceil(used.ru_utime + used.ru_stime) + seconds
    resource.setrlimit(resource.RLIMIT_CPU, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))
