"""Heartbeat file touched every second by a running process."""

from __future__ import annotations

import json
import os
import threading
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from steradian.core.atomic_files import atomic_write

INTERVAL = 1.0
STALE_AFTER = 4.0
"""Seconds without a sign after which a process counts as stuck."""


class Heartbeat:
    """Heartbeat of a process: a thread touches a file every second until the block ends."""

    def __init__(self, path: Path) -> None:
        self._path, self._over, self._writing = path, threading.Event(), threading.Lock()
        self._about: dict[str, object] = {"pid": os.getpid()}
        self._thread = threading.Thread(target=self._beat, daemon=True)

    def __enter__(self) -> Self:
        self._path.parent.mkdir(exist_ok=True)
        self._write()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._over.set()
        self._path.unlink(missing_ok=True)

    def set_gpu(self, name: str) -> None:
        """Store the name of the process's GPU in the heartbeat file."""
        self._about["gpu"] = name
        self._write()

    def _beat(self) -> None:
        while not self._over.wait(INTERVAL):
            with suppress(OSError):  # a folder that is away comes back, or the process ends
                try:
                    os.utime(self._path)
                except FileNotFoundError:
                    self._write()

    def _write(self) -> None:
        with self._writing, atomic_write(self._path) as beside:  # whoever reads it meanwhile gets a whole one
            beside.write_text(json.dumps(self._about))


def gpu_of(path: Path) -> str | None:
    """Return the name of the GPU in a heartbeat file, or ``None``."""
    try:
        return str(json.loads(path.read_text())["gpu"])
    except (OSError, ValueError, LookupError, TypeError):
        return None


def is_alive(path: Path, now: float) -> bool:
    """Return whether a heartbeat file was touched recently; ``now`` is in seconds since the epoch."""
    try:
        return now - path.stat().st_mtime < STALE_AFTER
    except OSError:
        return False
