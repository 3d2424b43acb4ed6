"""Staleness of a scan's stored copy: whether the scan was resumed after the upload."""

from __future__ import annotations

from datetime import datetime
from typing import Final

from steradian.storage.db.tables import ObjectRow, ScanRow
from steradian.storage.state_machines import ACTIVE_SCAN_STATES, ScanState

_WRITING: Final = ACTIVE_SCAN_STATES - {ScanState.ARMING}


def is_stale(scan: ScanRow, kept: ObjectRow) -> bool:
    """Return whether a scan was resumed since its file was stored, so that its scanner's node has newer A-lines."""
    if scan.scanner_id is None:
        return False
    begun = last_write_started(scan)
    return scan.state in ACTIVE_SCAN_STATES or (begun is not None and begun > kept.created)


def last_write_started(scan: ScanRow) -> datetime | None:
    """Return the last time at which a scan entered a state in which its file is written."""
    begun = [change["at"] for change in scan.history if change["state"] in _WRITING]
    return datetime.fromisoformat(begun[-1]) if begun else None
