"""Starting a simulator as a child process."""

from __future__ import annotations

import json
import select
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from fabry_perot.errors import PortUnavailable
from fabry_perot.simulator.options import Options


@dataclass(frozen=True, slots=True)
class Simulator:
    """A running simulator.

    Parameters
    ----------
    url
        What to give to :func:`fabry_perot.connect`.
    pid
        Its process id.
    """

    url: str
    pid: int


@contextmanager
def launch(
    *,
    tcp: str | None = None,
    link: str | None = None,
    speed: float = 1.0,
    seed: int = 0,
    noise_db: float = 30.0,
    phantom: str = "yarn",
    sound_speed: float = 1500.0,
    baud: int = 0,
    ring: int = 512,
    timeout: float = 30.0,
) -> Iterator[Simulator]:
    """Run ``python -m fabry_perot.simulator`` while the ``with`` block lasts.

    Parameters
    ----------
    tcp, link, speed, seed, noise_db, phantom, sound_speed, baud, ring
        See :class:`fabry_perot.simulator.Options`.
    timeout
        Seconds to wait until it is ready.

    Raises
    ------
    PortUnavailable
        It did not get ready.
    """
    options = Options(tcp, link, speed, seed, noise_db, phantom, sound_speed, baud, ring)
    command = [sys.executable, "-m", "fabry_perot.simulator", *options.arguments(), "--exit-with-stdin"]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        yield _ready(process, timeout)
    finally:
        _stop(process)


def _ready(process: subprocess.Popen[bytes], timeout: float) -> Simulator:
    assert process.stdout is not None  # noqa: S101
    readable, _, _ = select.select([process.stdout], [], [], timeout)
    line = process.stdout.readline() if readable else b""
    if not line:
        raise PortUnavailable(f"the simulator did not get ready within {timeout:g} s")
    ready = json.loads(line)
    return Simulator(url=ready["url"], pid=ready["pid"])


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
