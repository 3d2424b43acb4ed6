"""Change tracking of growing scan files: the rows that changed since a client's cursor."""

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
    """Poll history of a file: ``marks`` (F·M, ...) as last read, and the poll in which each row last changed."""

    epoch: str
    marks: NDArray[Any]
    found: NDArray[np.int64]
    look: int = 1


class RowDeltaTracker:
    """Tracker of the poll in which each row of a scan file last changed."""

    def __init__(self) -> None:
        self._files: dict[str, _File] = {}
        self._lock = Lock()

    def changed_since(self, name: str, marks: NDArray[Any], since: str | None) -> tuple[NDArray[np.bool_], str]:
        """Return which rows of a file changed since a cursor, and the next cursor.

        Parameters
        ----------
        name
            Name of the file.
        marks
            (F·M, K) values that change with the row; read before the rows themselves, so that no change is missed.
        since
            Cursor that an earlier call returned; with ``None`` or an outdated one, all rows count as changed.

        Returns
        -------
        (F·M,) mask of the changed rows, and the next cursor.
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
