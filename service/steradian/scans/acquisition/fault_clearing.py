"""Clearing of a scanner's latched fault; needs a person's name, is refused while the cause persists."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

import fabry_perot
from steradian.core.exceptions import Conflict, FaultStands, ScannerUnreachable
from steradian.scans.acquisition.scanner_status import described

LOOK: Final = 0.05
"""Seconds between two looks for a request."""
HEARD_WITHIN: Final = 2.0
"""Seconds for which a port that was just opened is listened to."""


def clear_through(
    monitor: fabry_perot.Monitor | None, url: str | None, *, is_lent: bool, wanted: Callable[[], bool]
) -> str:
    """Clear the latched fault of the scanner at a port and return the fault's name; empty if none is latched.

    Parameters
    ----------
    monitor
        What holds the port; ``None``: it is opened for this.
    url
        The port; ``None``: there is no scanner.
    is_lent
        Whether a scan of this process has the port.
    wanted
        Asked just before the fault is cleared, whether that is still wanted.

    Raises
    ------
    Conflict
        When a scan, or another program, has the port.
    FaultStands
        While the cause of the fault stands.
    ScannerUnreachable
        When the scanner does not answer.
    """
    if is_lent:
        raise Conflict("a scan has the scanner; its fault can be cleared when the scan is over or interrupted")
    if url is None:
        return ""
    if monitor is None:
        with _opened(url) as monitor:
            return _clear(monitor, wanted)
    return _clear(monitor, wanted)


def _clear(monitor: fabry_perot.Monitor, wanted: Callable[[], bool]) -> str:
    status, until = described(monitor).as_of_now(), time.monotonic() + HEARD_WITHIN
    while not status.state and monitor.connection != "busy" and time.monotonic() < until:
        time.sleep(LOOK)
        status = described(monitor).as_of_now()
    if monitor.connection == "busy":
        raise Conflict(f"the port is in use by {monitor.holder or 'another program'}; clear the fault there")
    if not status.state:
        raise ScannerUnreachable(monitor.error or "the scanner does not answer")
    if status.fault is None:
        return ""
    if not wanted():
        raise ScannerUnreachable("the scanner did not answer in time; the fault was not cleared")
    try:
        monitor.clear_fault()
    except fabry_perot.FaultStands as error:
        raise FaultStands(str(error)) from error
    except fabry_perot.ScannerError as error:
        raise ScannerUnreachable(f"the fault was not cleared: {error}") from error
    return str(status.fault["name"])


@contextmanager
def _opened(url: str) -> Iterator[fabry_perot.Monitor]:
    try:
        monitor = fabry_perot.Monitor(url)
    except fabry_perot.ScannerError as error:
        raise ScannerUnreachable(str(error)) from error
    try:
        yield monitor
    finally:
        monitor.close()
