"""A process whose standard input is a pipe to its parent ends with it, however the parent went."""

from __future__ import annotations

import os
from collections.abc import Callable


def end_with_stdin(end: Callable[[], object]) -> None:
    """Call ``end`` when standard input closes, that is when the process at its other end is gone."""
    while os.read(0, 4096):
        pass
    end()
