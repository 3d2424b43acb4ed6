"""Track which rows of a growing scan file changed since a client's cursor."""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_FILES = 16
"""Files that are kept in mind; who looks at another one again is told all of it."""


@dataclass(eq=False)
class _File:
    """State of a file: ``marks`` (F·M, ...), whose changes identify changed rows, and the time of each change."""

    epoch: str
    marks: NDArray[Any]
    found: NDArray[np.int64]
    look: int = 1


class RowDeltaTracker:
    """Remembers at which look each row of a file was first found as it is."""

    def __init__(self) -> None:
        self._files: dict[str, _File] = {}
        self._lock = Lock()

    def changed_since(self, name: str, marks: NDArray[Any], since: str | None) -> tuple[NDArray[np.bool_], str]:
        """Return the rows that changed since a cursor.

        Parameters
        ----------
        name
            Of the file.
        marks
            (F·M, K) what is different when a row is; read before the rows themselves, so that none is missed.
        since
            What an earlier call returned; with ``None``, or after too long, all rows count as changed.

        Returns
        -------
        (F·M,) which rows, and what to bring next time.
        """
        with self._lock:
            file = self._files.pop(name, None)
            if file is None or file.marks.shape != marks.shape:
                file = _File(secrets.token_hex(4), marks, np.ones(len(marks), np.int64))
            changed = (file.marks != marks).any(axis=1)
            if changed.any():
                file.look += 1
                file.found[changed] = file.look
                file.marks = marks
            self._files[name] = file
            if len(self._files) > MAX_FILES:
                del self._files[next(iter(self._files))]
            epoch, _, number = (since or "").partition(".")
            known = epoch == file.epoch and number.isascii() and number.isdecimal()
            rows: NDArray[np.bool_] = file.found > (int(number) if known else 0)
            return rows, f"{file.epoch}.{file.look}"
