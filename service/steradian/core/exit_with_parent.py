"""Exit of a child process when its parent exits, detected by a closed standard input."""

from __future__ import annotations

import os
from collections.abc import Callable


def exit_when_stdin_closes(end: Callable[[], object]) -> None:
    """Wait until standard input closes, because the parent process has exited, and call ``end``."""
    while os.read(0, 4096):
        pass
    end()
