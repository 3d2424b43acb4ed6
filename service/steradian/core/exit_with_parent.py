"""Exit when the parent process closes the pipe."""

from __future__ import annotations

import os
from collections.abc import Callable


def exit_when_stdin_closes(end: Callable[[], object]) -> None:
    """Call ``end`` when standard input closes because the process at its other end has exited."""
    while os.read(0, 4096):
        pass
    end()
