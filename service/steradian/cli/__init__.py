"""Command-line interface ``steradian`` and its entry point."""

from __future__ import annotations

import os
import signal


def main() -> None:
    """Run the command line; Ctrl-C during the imports ends the program with a one-line message."""
    heard = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if heard:
        signal.signal(signal.SIGINT, _exit_on_interrupt)
    from steradian.cli.app import main as run

    try:
        if heard:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        run()
    except KeyboardInterrupt:  # just before or after the command, which answers itself
        _exit_on_interrupt()


def _exit_on_interrupt(*_: object) -> None:
    os.write(2, b"error: stopped\n")
    os._exit(130)  # steradian.core.signal_safe_event.STOPPED; nothing is read before Ctrl-C is heard
