"""Child process that executes calls of Python functions, and the exit of a child with its parent.

Calls and results are pickled and sent through pipes: eight bytes with the length, then the pickle.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import IO, Any, ParamSpec, TypeVar, cast

_P = ParamSpec("_P")
_T = TypeVar("_T")


class ChildExited(RuntimeError):
    """Error: a child process ended during a call.

    Parameters
    ----------
    status
        Its exit code; negative: the number of the signal that ended it.
    """

    def __init__(self, status: int) -> None:
        self.status = status
        super().__init__(f"a process of the service ended {describe_exit(status)}")


class CallProcess:
    """Child process that executes one call of an importable function after another, until :meth:`end`.

    Parameters
    ----------
    options
        Options of :class:`subprocess.Popen`.
    """

    def __init__(self, **options: Any) -> None:
        command = [sys.executable, "-P", "-m", "steradian.core.child_process"]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, **options)

    def call(self, function: Callable[_P, _T], *args: _P.args, **options: _P.kwargs) -> _T:
        """Execute a function in the child process and return its result, or raise its exception.

        Raises
        ------
        ChildExited
            When the process ended or was killed meanwhile.
        """
        request, answer = pickle.dumps((function, args, options), pickle.HIGHEST_PROTOCOL), b""
        try:
            _write(cast("IO[bytes]", self._process.stdin), request)
            answer = _read(cast("IO[bytes]", self._process.stdout))
        except OSError:  # it has ended
            pass
        except BaseException:
            self._process.kill()  # an answer that is half read
            raise
        if not answer:
            self._process.kill()
            raise ChildExited(self._process.wait())
        is_error, value = pickle.loads(answer)  # noqa: S301 - our child wrote it
        if is_error:
            raise value
        return cast(_T, value)

    def kill(self) -> None:
        """Kill the process; its current call raises :class:`ChildExited`."""
        self._process.kill()

    def end(self) -> None:
        """Kill the process, wait until it has ended and close its pipes."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError):
                cast("IO[bytes]", pipe).close()


def describe_exit(status: int) -> str:
    """Return the end of a process in words: its exit code, or the signal that ended it."""
    if status >= 0:
        return f"with exit code {status}"
    with suppress(ValueError):
        return f"by signal {signal.Signals(-status).name}"
    return f"by signal {-status}"


def exit_when_stdin_closes(end: Callable[[], object]) -> None:
    """Wait until standard input closes, because the parent process has exited, and call ``end``."""
    while os.read(0, 4096):
        pass
    end()


def main() -> None:
    """Execute pickled calls from standard input and write their results, until standard input closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # the output of a library is not an answer
    while request := _read(sys.stdin.buffer):
        _write(answers, _answer(request))


def _answer(request: bytes) -> bytes:
    try:
        function, args, options = pickle.loads(request)  # noqa: S301 - our parent wrote it
        answer: tuple[bool, Any] = False, function(*args, **options)
    except Exception as error:
        answer = True, error
    try:
        return pickle.dumps(answer, pickle.HIGHEST_PROTOCOL)
    except Exception:
        return pickle.dumps((True, RuntimeError(f"{type(answer[1]).__name__}: {answer[1]}")))


def _write(pipe: IO[bytes], message: bytes) -> None:
    pipe.write(len(message).to_bytes(8, "big") + message)
    pipe.flush()


def _read(pipe: IO[bytes]) -> bytes:
    """Return the next message; empty at the end of the pipe."""
    size = pipe.read(8)
    return pipe.read(int.from_bytes(size, "big")) if len(size) == 8 else b""


if __name__ == "__main__":
    main()
