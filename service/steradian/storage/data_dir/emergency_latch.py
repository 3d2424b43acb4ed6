"""Emergency-stop latch: checksummed files in the data folder, readable without locks.

DATA/emergency-stop/pressed    the last press: its number, when, who, why
DATA/emergency-stop/released   the number of the last press that a person released
DATA/emergency-stop/answered   what the acquisition did about the last press

The stop stands while the last press has not been released. Each file is a block
(:mod:`steradian.storage.data_dir.shared_block`), so a full disk stops nobody. A press takes no lock; who releases names
the press he saw, so none that came after it is lost. A block that cannot be read counts as a press.
"""

from __future__ import annotations

import os
import time
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from threading import Lock
from typing import Any

from ulid import ULID

from steradian.storage.data_dir.shared_block import open_block, read_block, write_block


@dataclass(frozen=True)
class StopPress:
    """Record of one press of the emergency stop: number, time, principal and reason.

    Attributes
    ----------
    number
        Unique number of the press (a ULID); later ones are greater.
    at
        Time, ISO 8601 in UTC.
    who, reason
        Principal and reason.
    moment
        Time on this machine's monotonic clock, in s.
    """

    number: str
    at: str
    who: str
    reason: str | None
    moment: float

    @property
    def why(self) -> str:
        """Text of the reason for the emergency stop, for log lines and events."""
        return f"emergency stop: {self.reason or 'no reason given'}"


@dataclass(frozen=True)
class StopOutcome:
    """Outcome of an emergency stop, reported by the acquisition process: state of the laser and delay.

    Attributes
    ----------
    number
        Number of the press.
    laser
        ``off``: reported by the scanner after the stop; ``idle``: there is no scanner, or the simulated one was never
        started; ``unconfirmed``: the scanner did not answer, or reports that its laser is not off.
    seconds
        Delay from the press; ``None`` if the computer was restarted since.
    detail
        One sentence: the scanner's answer or the error; may be empty.
    """

    number: str
    laser: str
    seconds: float | None
    detail: str = ""


class EmergencyLatch:
    """Emergency-stop latch in a data folder, shared by several processes.

    Parameters
    ----------
    folder
        Folder of the latch's files, which are created if missing and stay open.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._files = {name: open_block(folder / name) for name in ("pressed", "released", "answered")}
        self._lock = Lock()

    def press(self, who: str, reason: str | None, number: str | None = None) -> StopPress:
        """Press the emergency stop, visible to every process at once; :meth:`make_durable` syncs it to disk.

        Parameters
        ----------
        number
            Number of a press that may be delivered more than once: repeated deliveries have no effect, also after the
            release.
        """
        press = StopPress(number or str(ULID()), datetime.now(UTC).isoformat(), who[:200], reason, time.monotonic())
        if number is not None and (earlier := self._earlier(press)) is not None:
            return earlier
        self._write("pressed", asdict(press))
        return press

    def make_durable(self) -> None:
        """Sync presses and releases to disk."""
        for name in ("pressed", "released"):
            getattr(os, "fdatasync", os.fsync)(self._files[name])

    def active(self) -> StopPress | None:
        """Return the press that is not released, or ``None``."""
        try:
            found, released = self._read("pressed"), self._read("released")
        except ValueError as error:
            return StopPress("", datetime.now(UTC).isoformat(), "unknown", f"the latch cannot be read: {error}", 0.0)
        if found is None or (released is not None and released["number"] == found["number"]):
            return None
        return StopPress(**found)

    def release(self, number: str) -> None:
        """Release the press with this number; another press stays active."""
        if not number:  # a latch that cannot be read gets blocks that can be
            number = self.press("release", "the latch could not be read").number
        self._write("released", {"number": number})
        self.make_durable()

    def record_outcome(self, deed: StopOutcome) -> None:
        """Store the outcome of a press."""
        self._write("answered", asdict(deed))

    def outcome(self, number: str) -> StopOutcome | None:
        """Return the recorded outcome of a press of the emergency stop, or None if there is none yet."""
        try:
            found = self._read("answered")
        except ValueError:
            return None
        return StopOutcome(**found) if found is not None and found["number"] == number else None

    def _earlier(self, press: StopPress) -> StopPress | None:
        """Return the press if the latch already contains its number (active or released), else ``None``."""
        try:
            found, released = self._read("pressed"), self._read("released")
        except (OSError, ValueError):  # what cannot be read keeps no press from being written
            return None
        if found is not None and found["number"] == press.number:
            return StopPress(**found)
        return press if released is not None and released["number"] == press.number else None

    def _write(self, name: str, value: dict[str, Any]) -> None:
        with self._lock:
            write_block(self._files[name], value)

    def _read(self, name: str) -> dict[str, Any] | None:
        return read_block(self._files[name], name)
