"""One job in one child process: the worker's end of the pipe, and the child's.

The child reads its payload as one JSON line from standard input, which then stays open: when it closes, the worker is
gone and the child ends. It writes JSON lines: ``{"stage", "done", "total"}`` on the way and at last ``{"result"}`` or
``{"error": {"code", "message"}}``. What it writes to standard error goes to the job's log.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
import threading
from asyncio.subprocess import PIPE, Process
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeAlias

from steradian.errors import SteradianError
from steradian.progress import Progress
from steradian.storage.jobs import Died, Failed, Succeeded

Report: TypeAlias = Callable[[str, int, int], Awaitable[None]]
"""Called by the worker with each stage, done and total that the child reports."""

LINE_LIMIT = 16 * 2**20


async def run_child(
    command: Sequence[str],
    payload: Mapping[str, Any],
    *,
    log: Path,
    environment: Mapping[str, str],
    report: Report,
    timeout: float,  # noqa: ASYNC109 - it ends a process, not only the waiting
) -> Succeeded | Failed | Died:
    """Run a job's program to its end; cancelling this coroutine kills it.

    Parameters
    ----------
    timeout
        Seconds after which the program is killed and the job has failed.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("ab") as errors:
        child = await asyncio.create_subprocess_exec(
            *command, stdin=PIPE, stdout=PIPE, stderr=errors, env=environment, limit=LINE_LIMIT
        )
        try:
            async with asyncio.timeout(timeout):
                return await _converse(child, payload, report)
        except TimeoutError:
            return Failed("timeout", f"the job did not end within {timeout:g} s")
        finally:
            await _end(child)


async def _converse(child: Process, payload: Mapping[str, Any], report: Report) -> Succeeded | Failed | Died:
    assert child.stdin is not None  # noqa: S101 - asked for above
    assert child.stdout is not None  # noqa: S101
    with suppress(ConnectionError):
        child.stdin.write(json.dumps(payload).encode() + b"\n")
        await child.stdin.drain()
    outcome: Succeeded | Failed | None = None
    async for line in child.stdout:
        match _parse(line):
            case {"stage": str(stage), "done": int(done), "total": int(total)}:
                await report(stage, done, total)
            case {"result": dict(result)}:
                outcome = Succeeded(result)
            case {"error": {"code": str(kind), "message": str(message)}}:
                outcome = Failed(kind, message)
            case _:
                pass
    code = await child.wait()
    return outcome or Died(f"the job's process ended {_ending(code)} without a result")


async def _end(child: Process) -> None:
    """Kill the child if it still runs and wait until its memory is free."""
    if child.returncode is None:
        with suppress(ProcessLookupError):
            child.kill()
    await asyncio.shield(asyncio.ensure_future(child.wait()))
    if child.stdin is not None:
        child.stdin.close()


def _parse(line: bytes) -> object:
    with suppress(ValueError):
        return json.loads(line)
    return None


def _ending(code: int) -> str:
    if code >= 0:
        return f"with exit code {code}"
    with suppress(ValueError):
        return f"by signal {signal.Signals(-code).name}"
    return f"by signal {-code}"


def child_main(work: Callable[[dict[str, Any], Progress], dict[str, Any]]) -> None:
    """Be the child: read the payload, do ``work``, report, and end when standard input closes.

    An error of our own tree is reported and final; any other ends the process with its traceback in the log, which
    counts as a deterministic failure too, named by its type.
    """
    payload = json.loads(sys.stdin.readline())
    threading.Thread(target=end_with_stdin, args=(lambda: os._exit(70),), daemon=True).start()
    speak = _Speaker()
    try:
        result = work(payload, lambda stage, done, total: speak(stage=stage, done=int(done), total=int(total)))
    except SteradianError as error:
        speak(error={"code": error.code, "message": str(error)})
    except MemoryError:
        speak(error={"code": "out-of-memory", "message": "the job needs more memory than there is"})
    except Exception as error:
        import traceback

        traceback.print_exc()
        speak(error={"code": "internal", "message": f"{type(error).__name__}: {error}"})
    else:
        speak(result=result)


def end_with_stdin(end: Callable[[], object]) -> None:
    """Call ``end`` when standard input closes, that is when the process at its other end is gone."""
    while os.read(0, 4096):
        pass
    end()


class _Speaker:
    """JSON lines on standard output, whole ones whatever thread speaks."""

    def __init__(self) -> None:
        self._lock = threading.Lock()

    def __call__(self, **message: Any) -> None:
        with self._lock:
            sys.stdout.write(json.dumps(message) + "\n")
            sys.stdout.flush()
