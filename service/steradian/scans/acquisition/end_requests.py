"""Wishes to end a scan are heard also while a request to the scanner waits for a line that does not answer."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import fabry_perot
from steradian.core.exceptions import ScanFailed
from steradian.scans.acquisition.control import TERMINAL_COMMANDS, Command, SessionControl

LOOK: Final = 0.1
"""Seconds between two looks at what is wished."""
GRACE: Final = 1.0
"""Seconds for which the session itself may act on a wish before its connection is closed."""


class GivenUp(ScanFailed):
    """A session was ended by a wish before the scanner had answered.

    Parameters
    ----------
    wish
        What was wished.
    """

    def __init__(self, wish: Command) -> None:
        self.wish = wish
        super().__init__(f"the scan was ended on request ({wish}) before the scanner had answered")


def ending_wish(control: SessionControl) -> Command | None:
    """Return the wish that ends the session, if there is one."""
    try:
        wish = control.command()
    except Exception:  # what speaks against the scan is raised where it is asked for in order
        return None
    return wish if wish in TERMINAL_COMMANDS else None


@contextmanager
def hearing(scanner: fabry_perot.Scanner, control: SessionControl) -> Iterator[None]:
    """Close the connection when a wish to end the scan is not acted upon within :data:`GRACE` seconds.

    For the time in which the scanner is prepared: the laser is off or goes off with the connection, and the file holds
    all that was measured before.

    Raises
    ------
    GivenUp
        When the connection was closed for a wish.
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
            raise GivenUp(closed_for[0]) from error
        raise
    finally:
        over.set()
