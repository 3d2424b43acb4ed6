"""The emergency stop as a latch in the data folder: it needs no database, no free disk space and no answer of anybody.

DATA/emergency-stop/pressed    the last press: its number, when, who, why
DATA/emergency-stop/released   the number of the last press that a person released
DATA/emergency-stop/answered   what the acquisition did about the last press

The stop stands while the last press has not been released. Each file has its full size from the start and is
overwritten in place, so a full disk stops nobody (on file systems that copy on write a reserve must be left to them).
A press takes no lock; who releases names the press he saw, so none that came after it is lost. A block that cannot be
read counts as a press.
"""

from __future__ import annotations

import json
import os
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from tempfile import NamedTemporaryFile
from threading import Lock
from typing import Any, Final

import google_crc32c
from ulid import ULID

SIZE: Final = 4096
_BLANK: Final = bytes(SIZE)
_LOOKS, _BETWEEN = 5, 0.001
"""A block that is being written is looked at again, so often and after so many seconds."""


@dataclass(frozen=True)
class Press:
    """One press of the stop.

    Attributes
    ----------
    number
        Of this press alone; later ones are greater.
    at
        When, ISO 8601 in UTC.
    who, reason
        By whom and why.
    moment
        When by this machine's monotonic clock, in s.
    """

    number: str
    at: str
    who: str
    reason: str | None
    moment: float

    @property
    def why(self) -> str:
        """The stop as the reason of what follows from it."""
        return f"emergency stop: {self.reason or 'no reason given'}"


@dataclass(frozen=True)
class Deed:
    """What the acquisition did about a press.

    Attributes
    ----------
    number
        Of the press.
    laser
        ``off``: the scanner confirmed it; ``idle``: no scan ran, nothing was armed; ``unconfirmed``: the scanner does
        not answer, its laser goes off when the lease that nobody renews ends.
    seconds
        From the press; ``None`` where the computer was started anew since.
    """

    number: str
    laser: str
    seconds: float | None


class EmergencyLatch:
    """The latch of one data folder; any number of processes may hold one.

    Parameters
    ----------
    folder
        Where its files are; they are made if they are missing, and kept open.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._files = {name: _open(folder / name) for name in ("pressed", "released", "answered")}
        self._lock = Lock()

    def press(self, who: str, reason: str | None, number: str | None = None) -> Press:
        """Press the stop, seen by every process at once; :meth:`make_durable` makes it survive a power cut.

        Parameters
        ----------
        number
            Of a press that may come more than once: it is pressed once, and not again after its release.
        """
        press = Press(number or str(ULID()), datetime.now(UTC).isoformat(), who[:200], reason, time.monotonic())
        if number is not None and (earlier := self._earlier(press)) is not None:
            return earlier
        self._write("pressed", asdict(press))
        return press

    def make_durable(self) -> None:
        """Wait until what was pressed or released is on the disk."""
        for name in ("pressed", "released"):
            getattr(os, "fdatasync", os.fsync)(self._files[name])

    def standing(self) -> Press | None:
        """Return the press that nobody has released, if there is one."""
        try:
            found, released = self._read("pressed"), self._read("released")
        except ValueError as error:
            return Press("", datetime.now(UTC).isoformat(), "unknown", f"the latch cannot be read: {error}", 0.0)
        if found is None or (released is not None and released["number"] == found["number"]):
            return None
        return Press(**found)

    def release(self, number: str) -> None:
        """Release the press of this number; another one goes on standing."""
        if not number:  # a latch that cannot be read gets blocks that can be
            number = self.press("release", "the latch could not be read").number
        self._write("released", {"number": number})
        self.make_durable()

    def answer(self, deed: Deed) -> None:
        """Say what was done about a press."""
        self._write("answered", asdict(deed))

    def deed(self, number: str) -> Deed | None:
        """Return what was done about a press, if something was."""
        try:
            found = self._read("answered")
        except ValueError:
            return None
        return Deed(**found) if found is not None and found["number"] == number else None

    def _earlier(self, press: Press) -> Press | None:
        """Return a press that was here before, as far as the blocks tell."""
        try:
            found, released = self._read("pressed"), self._read("released")
        except (OSError, ValueError):  # what cannot be read keeps no press from being written
            return None
        if found is not None and found["number"] == press.number:
            return Press(**found)
        return press if released is not None and released["number"] == press.number else None

    def _write(self, name: str, value: dict[str, Any]) -> None:
        body = json.dumps(value, ensure_ascii=False).encode().ljust(SIZE - 9)
        with self._lock:
            os.pwrite(self._files[name], b"%08x " % google_crc32c.value(body) + body, 0)

    def _read(self, name: str) -> dict[str, Any] | None:
        """Return what a file holds, ``None`` while nothing was ever written; raises ValueError if it is damaged."""
        for _ in range(_LOOKS):
            block = os.pread(self._files[name], SIZE, 0)
            if block == _BLANK:
                return None
            if block[:9] == b"%08x " % google_crc32c.value(block[9:]) and len(block) == SIZE:
                value: dict[str, Any] = json.loads(block[9:])
                return value
            time.sleep(_BETWEEN)
        raise ValueError(f"{name} does not match its checksum")


def _open(path: Path) -> int:
    """Open a block; one that is missing appears at its full size at once, so that nobody's press is overwritten."""
    if not path.exists():
        with NamedTemporaryFile(dir=path.parent, prefix=f"{path.name}.") as draft:
            draft.write(_BLANK)
            draft.flush()
            os.fsync(draft.fileno())
            with suppress(FileExistsError):
                os.link(draft.name, path)
    return os.open(path, os.O_RDWR | getattr(os, "O_CLOEXEC", 0))
