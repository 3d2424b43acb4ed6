"""Launcher of a simulator as a child process."""

from __future__ import annotations

import json
import select
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fabry_perot.errors import PortUnavailable
from fabry_perot.simulator.options import Options


class Simulator:
    """Running simulator process, with its port and control channel.

    Parameters
    ----------
    process
        The process, with pipes to its standard input and output.
    url
        What to give to :func:`fabry_perot.connect`.
    pid
        Its process id.
    """

    def __init__(self, process: subprocess.Popen[bytes], url: str, pid: int) -> None:
        self._process, self.url, self.pid = process, url, pid

    def send_command(self, do: str, **fields: Any) -> dict[str, Any]:
        """Send a control command, e.g. a fault, and return the answer (:mod:`fabry_perot.simulator.fault_commands`).

        Raises
        ------
        ValueError
            It did not understand.
        """
        assert self._process.stdin is not None  # noqa: S101
        self._process.stdin.write(json.dumps({"do": do, **fields}).encode() + b"\n")
        self._process.stdin.flush()
        answer: dict[str, Any] = json.loads(_line(self._process, 30.0))
        if "error" in answer:
            raise ValueError(answer["error"])
        return answer


@contextmanager
def launch(*, timeout: float = 30.0, **settings: Any) -> Iterator[Simulator]:
    """Context manager that runs a simulator process (``python -m fabry_perot.simulator``) and stops it at the end.

    A pseudo-terminal gets a name of its own, by a link: the number of an unplugged one may be somebody else's next.
    It is no part of the caller's process group: Ctrl-C at a terminal is for the caller, who still needs the scanner to
    make the scan safe. It ends with its standard input, so it does not outlive the caller either.

    Parameters
    ----------
    timeout
        Seconds to wait until it is ready.
    settings
        Fields of :class:`fabry_perot.simulator.Options`: ``tcp``, ``link``, ``speed``, ``seed``, ``noise_db``, …

    Raises
    ------
    PortUnavailable
        It did not get ready.
    """
    options = Options(**settings)
    command = [sys.executable, "-P", "-m", "fabry_perot.simulator", *options.arguments(), "--exit-with-stdin"]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, start_new_session=True
    )
    ready: dict[str, Any] = {}
    try:
        ready = json.loads(_line(process, timeout))
        yield Simulator(process, ready["link"] or ready["url"], ready["pid"])
    finally:
        _stop(process)
        if ready and not options.tcp and not options.link:  # it removes its folder itself, unless it was killed
            shutil.rmtree(Path(ready["link"]).parent, ignore_errors=True)


def _line(process: subprocess.Popen[bytes], timeout: float) -> bytes:
    assert process.stdout is not None  # noqa: S101
    readable, _, _ = select.select([process.stdout], [], [], timeout)
    line = process.stdout.readline() if readable else b""
    if not line:
        raise PortUnavailable(f"the simulator did not answer within {timeout:g} s")
    return line


def _stop(process: subprocess.Popen[bytes]) -> None:
    assert process.stdin is not None  # noqa: S101
    assert process.stdout is not None  # noqa: S101
    process.stdin.close()
    try:
        process.wait(5.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    process.stdout.close()
