"""The command line: the same nouns as everywhere, without a server where none is needed."""

from __future__ import annotations

import os
import signal

STOPPED = 130
"""Exit code of a command that was stopped."""


def main() -> None:
    """Run the program; Ctrl-C while it is still being read ends it with one line, as it does later on."""
    heard = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if heard:
        signal.signal(signal.SIGINT, _leave)
    from steradian.cli.app import main as run

    if heard:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    run()


def _leave(*_: object) -> None:
    os.write(2, b"error: stopped\n")
    os._exit(STOPPED)
