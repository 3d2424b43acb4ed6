"""Repository of scanners with the operator's lease and the emergency stop."""

from __future__ import annotations

from datetime import timedelta

from sqlalchemy import select
from sqlalchemy.orm import Session

from steradian.core.exceptions import Conflict
from steradian.storage.db.tables import ScannerRow, ScanRow
from steradian.storage.repositories.event_log import append_event
from steradian.storage.repositories.scanner_registry import ENSURE_LOCK, PRESENT, SCANNER_ID, ScannerRegistry
from steradian.storage.state_machines import ACTIVE_SCAN_STATES, DesiredScanState, ScanState

__all__ = ["ENSURE_LOCK", "PRESENT", "SCANNER_ID", "EmergencyStopped", "LeaseHeld", "ScannerRepository"]
MAX_NAME_LENGTH = 120
"""Of a principal's name in a column."""


class LeaseHeld(Conflict):
    """Error: another operator has the lease of the scanner."""

    code = "lease-held"


class EmergencyStopped(Conflict):
    """Error: the emergency stop is active."""

    code = "emergency-stopped"


class ScannerRepository(ScannerRegistry):
    """Repository of scanners with leases and emergency stops; parameters as in :class:`ScannerRegistry`."""

    def lease(self, holder: str, seconds: float, note: str | None, who: str, fence: int | None = None) -> ScannerRow:
        """Acquire or renew the lease of the scanner; a new lease gets a greater fencing token.

        Parameters
        ----------
        holder
            How the caller calls itself: tells clients of the same principal apart.
        who
            The principal, whose the lease is.
        fence
            The number that the caller holds already, whatever it calls itself; ``None`` when it states none.

        Raises
        ------
        LeaseHeld
            When another principal holds it, or a client of the same one with another name and without its number.
        """
        with self.database.write() as session:
            row = self._find(session, self.id, lock=True)
            mine = row.held_by == who and (row.holder == holder or row.fence == fence)
            if self._is_held(row) and not mine:
                raise LeaseHeld(f"the scanner is held by {_holder(row)} until {row.lease_ends:%H:%M:%S} UTC")
            if not self._is_held(row):
                row.fence += 1
                self._event(session, row, who, f"leased by {holder}")
            row.holder, row.held_by = holder, who
            row.lease_ends, row.note = self.clock() + timedelta(seconds=seconds), note
        return row

    def release(self, fence: int, who: str, *, whoever: bool = False) -> None:
        """Release the scanner's lease; no effect without a lease.

        Parameters
        ----------
        whoever
            Whether the lease may be another principal's.

        Raises
        ------
        LeaseHeld
            When the lease has another number, or is another's.
        """
        with self.database.write() as session:
            row = self._find(session, self.id, lock=True)
            if not self._is_held(row):
                return
            if row.held_by != who and not whoever:
                raise LeaseHeld(f"the scanner is held by {_holder(row)}")
            if row.fence != fence:
                raise LeaseHeld(f"the scanner is held by {_holder(row)} under another number")
            row.lease_ends = row.holder = row.held_by = row.note = None
            self._event(session, row, who, "released")

    def check_fence(self, session: Session, fence: int | None, who: str) -> int:
        """Return the fencing token if the caller may fire the laser; raises LeaseHeld or EmergencyStopped.

        Parameters
        ----------
        fence
            The number that the caller holds; ``None`` when it states none.
        who
            The principal who asks.

        Raises
        ------
        LeaseHeld
            When the scanner is leased to another principal or under another number, or ``fence`` is of an old lease.
        EmergencyStopped
            When the emergency stop is pressed.
        """
        row = self._find(session, self.id, lock=True)
        if row.stopped_at is not None:
            raise EmergencyStopped(f"{row.stopped_by} pressed the emergency stop; release it first")
        if self._is_held(row) and row.held_by != who:
            raise LeaseHeld(f"the scanner is held by {_holder(row)} until {row.lease_ends:%H:%M:%S} UTC")
        if self._is_held(row) and fence != row.fence:
            raise LeaseHeld(f"the scanner is held by {_holder(row)}; send the lease's number as Scanner-Lease")
        if fence is not None and fence != row.fence:
            raise LeaseHeld(f"the lease {fence} is over; the scanner is at {row.fence}")
        return row.fence

    def refusal_reason(self, scan: ScanRow) -> str | None:
        """Return the reason why a queued scan must not fire (emergency stop, other lease); ``None`` if it may."""
        row = self.get(self.id)
        if row.stopped_at is not None:
            return "the emergency stop is pressed"
        if self._is_held(row) and scan.fence != row.fence:
            return f"it was requested under lease {scan.fence}, and the scanner is held under {row.fence}"
        return None

    def stop(self, who: str, reason: str | None, number: str | None = None, *, carried: bool = False) -> ScannerRow:
        """Activate the emergency stop: block new scans and set the desired state of unfinished ones to aborted.

        Parameters
        ----------
        number
            Of the press, if it has one.
        carried
            Whether its node may not know of it yet: a press that stands keeps its number.
        """
        now, who = self.clock(), who[:MAX_NAME_LENGTH]  # a stop is noted, whatever it is called that pressed it
        with self.database.write() as session:
            row = self._find(session, self.id, lock=True)
            row.stopped_at, row.stopped_by, row.stop_reason = row.stopped_at or now, row.stopped_by or who, reason
            if row.stop_number is None or (number is not None and not carried):
                row.stop_number, row.stop_laser, row.stop_seconds, row.stop_detail = number, None, None, None
            why = f"emergency stop: {reason or 'no reason given'}"
            mine = (ScanRow.scanner_id == self.id) & ScanRow.state.in_([*ACTIVE_SCAN_STATES, ScanState.QUEUED])
            for scan in session.scalars(select(ScanRow).where(mine).with_for_update()):
                if scan.desired_state is not DesiredScanState.ABORTED:
                    scan.desired_state, scan.reason, scan.wished_by = DesiredScanState.ABORTED, why, who
                    wished = {"state": scan.state, "desired_state": "aborted", "who": who, "why": why}
                    append_event(session, now, "scan", scan.id, wished)
            self._event(session, row, who, why)
        return row

    def record_stop_outcome(self, number: str, laser: str, seconds: float | None, detail: str = "") -> None:
        """Store the outcome of the active emergency stop, identified by the number of the press."""
        with self.database.write() as session:
            row = self._find(session, self.id, lock=True)
            if row.stopped_at is not None:
                row.stop_number, row.stop_laser, row.stop_seconds, row.stop_detail = number, laser, seconds, detail

    def release_stop(self, who: str, reason: str | None = None, number: str | None = None) -> ScannerRow:
        """Release the emergency stop; scans start again only at a person's request.

        Raises
        ------
        EmergencyStopped
            When the press that stands has another number than is given.
        """
        with self.database.write() as session:
            row = self._find(session, self.id, lock=True)
            if number is not None and row.stop_number not in {None, number}:
                raise EmergencyStopped(f"{row.stopped_by} pressed the emergency stop; look again before you release it")
            if row.stopped_at is not None:
                row.stopped_at = row.stopped_by = row.stop_reason = row.stop_number = None
                self._event(session, row, who, "emergency stop released" + (f": {reason}" if reason else ""))
        return row

    def is_held(self, row: ScannerRow) -> bool:
        """Return whether the scanner has an unexpired lease."""
        return self._is_held(row)

    def _is_held(self, row: ScannerRow) -> bool:
        return row.lease_ends is not None and row.lease_ends > self.clock()


def _holder(row: ScannerRow) -> str:
    return f"{row.holder} ({row.held_by})"
