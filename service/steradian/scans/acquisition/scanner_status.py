"""Conversion of the driver's scanner status to the service's: laser, shutter, interlock, key, fault."""

from __future__ import annotations

import time
from typing import Any, Final

import fabry_perot
from fabry_perot import fault_codes
from fabry_perot.host.stop_and_status_results import in_words
from steradian.storage.data_dir.scanner_status import UNKNOWN, ScannerStatus

_LATCHED: Final = frozenset({"fault", "estop"})
LOST: Final = 2.0
"""Seconds without a word from a scan's scanner after which it does not count as connected."""
_CONNECTIONS: Final = {"connected": "connected", "disconnected": "disconnected", "busy": "in-use"}


def status_of(scanner: fabry_perot.Scanner) -> ScannerStatus | None:
    """Return the latest status of a connected scanner; ``None`` if it has sent none."""
    try:
        heard = in_words(scanner.status, scanner.seconds_since_heard)
    except fabry_perot.ScannerError:
        return None
    if heard.age > LOST:
        return _told(heard, "disconnected", "the scanner is silent; reconnecting to its scan", None)
    return _told(heard, "connected", None, None)


def described(monitor: fabry_perot.Monitor) -> ScannerStatus:
    """Convert the state of a port monitor to the service's scanner status."""
    connection = _CONNECTIONS.get(monitor.connection, UNKNOWN)
    holder = monitor.holder or None if connection == "in-use" else None
    heard = monitor.status
    if heard is None:
        return ScannerStatus(connection=connection, error=monitor.error, holder=holder)
    return _told(heard, connection, monitor.error, holder)


def fault_of(heard: fabry_perot.PortStatus) -> dict[str, Any] | None:
    """Return the latched fault of a port status as a dictionary with title and remedy; ``None`` without one."""
    if heard.state not in _LATCHED:
        return None
    fault = fault_codes.by_code(0 if heard.state == "estop" else heard.fault)
    light = heard.laser == "on" or heard.shutter == "open"
    cause = fault_codes.standing(
        fault.code, interlock_closed=heard.interlock == "closed", key_on=heard.key == "on", light=light
    )
    told = {"code": fault.code, "name": fault.name, "title": fault.title, "remedy": fault.remedy}
    return told | {"clearable": not cause}


def _told(heard: fabry_perot.PortStatus, connection: str, error: str | None, holder: str | None) -> ScannerStatus:
    fault = fault_of(heard)
    return ScannerStatus(
        connection=connection,
        state=heard.state,
        laser=heard.laser,
        shutter=heard.shutter,
        interlock=heard.interlock,
        key=heard.key,
        fault=fault,
        error=error or (None if fault is None else f"{fault['title']}; {fault['remedy']}, then clear the fault"),
        holder=holder,
        heard=time.monotonic() - heard.age,
    )
