"""Current scanner status in a shared file, written by the acquisition process and read by the API of its node.

DATA/emergency-stop/status   laser, shutter, interlock, key, fault, connection, and when the scanner said so

It needs no database. Times are of the machine's monotonic clock, which all its processes share; after a restart of the
computer an old block counts as unknown.
"""

from __future__ import annotations

import re
import time
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock
from typing import Any, Final, Self

from steradian.storage.data_dir.shared_block import open_block, read_block, write_block

UNKNOWN: Final = "unknown"
CURRENT: Final = 1.0
"""Seconds after which what the scanner said last does not hold any more."""
CURRENT_ELSEWHERE: Final = 10.0
"""The same for a scanner of another node, which is known from the database."""
LOOK_INTERVAL: Final = 0.2
"""Longest time between two writes of the block while the acquisition process works, in s."""
LOOK_INTERVAL_ELSEWHERE: Final = 4.0
"""Longest time between two writes of the scanner's row in the database of a service that is several nodes, in s."""


@dataclass(frozen=True)
class ScannerStatus:
    """Last status reported by the scanner: connection, laser, shutter, interlock, fault and time.

    Attributes
    ----------
    connection
        ``connected``, ``disconnected``, ``in-use`` (another program holds the port) or ``unknown``.
    state
        State of the device in lower case; empty: unknown.
    laser
        ``off``, ``armed``, ``on`` or ``unknown``.
    shutter, interlock
        ``open``, ``closed`` or ``unknown``.
    key
        ``on``, ``off`` or ``unknown``.
    fault
        The latched fault (``code``, ``name``, ``title``, ``remedy``, ``clearable``), or ``None``.
    error
        Error of the connection to the scanner, or ``None``.
    holder
        Other program that holds the port, or ``None``.
    model, serial
        Identity of the scanner; empty: unknown.
    heard
        Time of the scanner's last report, in s of the monotonic clock; ``None``: no report yet.
    """

    connection: str = UNKNOWN
    state: str = ""
    laser: str = UNKNOWN
    shutter: str = UNKNOWN
    interlock: str = UNKNOWN
    key: str = UNKNOWN
    fault: dict[str, Any] | None = None
    error: str | None = None
    holder: str | None = None
    model: str = ""
    serial: str = ""
    heard: float | None = None

    def age(self, now: float | None = None) -> float | None:
        """Return the age of the status in seconds; ``None`` if unknown."""
        if self.heard is None:
            return None
        passed = (time.monotonic() if now is None else now) - self.heard
        return passed if passed >= 0 else None

    def as_of_now(self, now: float | None = None) -> Self:
        """Return the status, with the scanner's values unknown if it is older than :data:`CURRENT` seconds."""
        age = self.age(now)
        return self if age is not None and age <= CURRENT else self.forgotten()

    def forgotten(self) -> Self:
        """Return a copy in which all values reported by the scanner are unknown."""
        return replace(self, state="", laser=UNKNOWN, shutter=UNKNOWN, interlock=UNKNOWN, key=UNKNOWN, fault=None)


def wording(text: str | None) -> str:
    """Return a message without its digits, so that messages which differ only in numbers compare equal."""
    return re.sub(r"\d+", "", text or "")


SILENT_ACQUISITION: Final = "the acquisition process does not answer"


class StatusBlock:
    """Shared file with the scanner status; one process writes it, others read it.

    Parameters
    ----------
    folder
        Folder of the file, which is created if missing and stays open.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._file, self._lock = open_block(folder / "status"), Lock()

    def write(self, status: ScannerStatus) -> None:
        """Write the scanner status to the shared file."""
        with self._lock:
            write_block(self._file, vars(status) | {"written": time.monotonic()})

    def read(self) -> ScannerStatus:
        """Return the scanner status; all fields are unknown if the last write is older than :data:`CURRENT` seconds."""
        try:
            found = read_block(self._file, "status")
        except (OSError, ValueError):
            found = None
        if found is None:
            return ScannerStatus()
        now, written = time.monotonic(), found.pop("written")
        status = ScannerStatus(**found)
        if not 0 <= now - written <= CURRENT:
            return replace(status.forgotten(), connection=UNKNOWN, holder=None, error=SILENT_ACQUISITION)
        return status.as_of_now(now)
