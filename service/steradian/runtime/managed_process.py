"""Supervised child process, restarted with exponential backoff."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import IO

from steradian.storage.data_dir.layout import UMASK

INITIAL_BACKOFF, LAST_BACKOFF = 0.5, 30.0
STABLE_AFTER = 30.0
"""Seconds after which a process counts as healthy, so that its next restart is immediate again."""
_log = logging.getLogger(__name__)


@dataclass
class ManagedProcess:
    """Supervised process, restarted with exponential backoff whenever it ends."""

    name: str
    command: Sequence[str]
    environment: dict[str, str]
    descriptors: tuple[int, ...] = ()
    output: IO[bytes] | None = None
    process: subprocess.Popen[bytes] | None = None
    started: float = 0.0
    backoff: float = INITIAL_BACKOFF
    due: float = field(default=0.0)

    def start(self, now: float, *, waits: bool = False) -> None:
        """Start the process in a session of its own, so that Ctrl-C reaches only the supervisor.

        Parameters
        ----------
        now
            Time on the monotonic clock.
        waits
            Whether a process that reads a byte of its standard input waits there until :meth:`go_on`.
        """
        self.process = subprocess.Popen(
            self.command,
            stdin=subprocess.PIPE,
            stderr=self.output,
            stdout=self.output,
            env=self.environment,
            pass_fds=self.descriptors,
            start_new_session=True,
            umask=UMASK if os.name == "posix" else -1,
        )
        self.started = now
        if not waits:
            self.go_on()

    def go_on(self) -> None:
        """Write a byte to the standard input of the process."""
        if self.process is not None and self.process.stdin is not None:
            with suppress(BrokenPipeError):
                self.process.stdin.write(b"\n")
                self.process.stdin.flush()

    def tend(self, now: float) -> None:
        """Restart the process if it has ended, with exponential backoff; to be called periodically."""
        if self.process is None:
            if now >= self.due:
                self.start(now)
            return
        code = self.process.poll()
        if code is None:
            return
        self.backoff = INITIAL_BACKOFF if now - self.started > STABLE_AFTER else min(2 * self.backoff, LAST_BACKOFF)
        _log.error("%s ended with code %d; starting it again in %g s", self.name, code, self.backoff)
        self._close_pipe()
        self.process, self.due = None, now + self.backoff

    @property
    def has_ended(self) -> bool:
        """Whether the process was started and has ended since."""
        return self.process is not None and self.process.poll() is not None

    def ended_at_once(self, now: float) -> bool:
        """Return whether the process ended soon after its start."""
        return self.has_ended and now - self.started < STABLE_AFTER

    def ask_to_end(self) -> None:
        """Send SIGTERM to the process."""
        if self.process is not None and self.process.poll() is None:
            self.process.terminate()

    def end(self, deadline: float) -> None:
        """Wait until the process has ended; after the deadline, kill its process group."""
        if self.process is None:
            return
        try:
            self.process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            _log.error("%s did not end in time and is killed", self.name)
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        self._close_pipe()

    def _close_pipe(self) -> None:
        if self.process is not None and self.process.stdin is not None:
            with suppress(BrokenPipeError):
                self.process.stdin.close()
