"""Ending of a scan by abort, stop or shutdown commands while a scanner request is blocked."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import fabry_perot
from steradian.core.exceptions import ScanFailed
from steradian.scans.acquisition.session_control import TERMINAL_COMMANDS, Command, SessionControl

LOOK: Final = 0.1
"""Seconds between two polls of the command."""
GRACE: Final = 1.0
"""Seconds in which the session may execute a command itself before its connection is closed."""


class EndedByRequest(ScanFailed):
    """Error of a session that was ended by a command before the scanner had answered.

    Parameters
    ----------
    wish
        The command that ended the session.
    """

    def __init__(self, wish: Command) -> None:
        self.wish = wish
        super().__init__(f"the scan was ended on request ({wish}) before the scanner had answered")


def ending_wish(control: SessionControl) -> Command | None:
    """Return the current command if it ends the session (stop, abort or shutdown); else ``None``."""
    try:
        wish = control.command()
    except Exception:  # what speaks against the scan is raised where it is asked for in order
        return None
    return wish if wish in TERMINAL_COMMANDS else None


@contextmanager
def hearing(scanner: fabry_perot.Scanner, control: SessionControl) -> Iterator[None]:
    """Close the scanner connection if an ending command is not executed within :data:`GRACE` seconds.

    Used while the scanner is prepared: the laser is off or switches off with the connection, and the file has all
    A-lines measured before.

    Raises
    ------
    EndedByRequest
        When the connection was closed because of a command.
    """
    over, closed_for = threading.Event(), list[Command]()

    def listen() -> None:
        waited = 0.0
        while not over.wait(LOOK):
            wish = ending_wish(control)
            waited = waited + LOOK if wish is not None else 0.0
            if wish is not None and waited >= GRACE:
                closed_for.append(wish)
                scanner.close()
                return

    thread = threading.Thread(target=listen, name="scan-wishes", daemon=True)
    thread.start()
    try:
        yield
    except fabry_perot.ScannerError as error:
        if closed_for:
            raise EndedByRequest(closed_for[0]) from error
        raise
    finally:
        over.set()
