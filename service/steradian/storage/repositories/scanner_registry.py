"""Repository of scanners: nodes, activity and reported state."""

from __future__ import annotations

from contextlib import suppress
from datetime import timedelta
from typing import Any, Self

from sqlalchemy import select, update
from sqlalchemy.orm import Session

from steradian.core.exceptions import NotFound
from steradian.core.settings import DEFAULT_SCANNER_ID
from steradian.storage.data_dir.scanner_status import ScannerStatus, wording
from steradian.storage.db.database import Database, advisory_xact_lock
from steradian.storage.db.tables import ScannerRow, ScanRow
from steradian.storage.db.timestamps_and_ids import Clock, utc_now
from steradian.storage.repositories.base import Repository
from steradian.storage.repositories.deletion import InUse
from steradian.storage.repositories.event_log import append_event
from steradian.storage.state_machines import ScanState, is_terminal

SCANNER_ID = DEFAULT_SCANNER_ID
"""The scanner where nobody says which."""
ENSURE_LOCK = 0x57E2AD1E
"""Number of the PostgreSQL advisory lock under which a scanner is noted."""
PRESENT = ScannerRow.retired.is_(None)
"""Which scanners there are."""
_OVER = tuple(state for state in ScanState if is_terminal(state))


class ScannerRegistry(Repository[ScannerRow]):
    """Repository of scanners, with one scanner selected; decommissioned scanners are excluded.

    Parameters
    ----------
    scanner_id
        Selected scanner, used by all methods except :meth:`get` and lists.
    """

    kind, table = "scanner", ScannerRow

    def __init__(self, database: Database, clock: Clock = utc_now, scanner_id: str = SCANNER_ID) -> None:
        super().__init__(database, clock)
        self.id = scanner_id

    def of(self, scanner_id: str) -> Self:
        """Return the repository with another scanner selected."""
        return type(self)(self.database, self.clock, scanner_id)

    def ensure(self, *, simulated: bool, address: str | None = None, follows: bool = False) -> ScannerRow:
        """Return the scanner's row, inserted at its first start or reactivated after decommissioning.

        Parameters
        ----------
        address
            URL of the scanner's node for other nodes.
        follows
            Whether that node has workers of its own for live jobs.
        """
        with self.database.write() as session:
            advisory_xact_lock(session, ENSURE_LOCK)  # API and acquisition of a node start at once
            row = session.scalars(select(ScannerRow).where(ScannerRow.id == self.id)).one_or_none()
            if row is None:
                now = self.clock()
                state = {"connection": "unknown", "state": "idle", "since": now, "fence": 0}
                row = ScannerRow(id=self.id, simulated=simulated, **state)
                session.add(row)
            row.simulated, row.address, row.follows, row.retired = simulated, address, follows, None
        return row

    def retire(self, who: str, reason: str | None = None) -> None:
        """Decommission the scanner until its node registers it again; an active emergency stop stays active.

        Raises
        ------
        InUse
            When a scan of it is not over.
        """
        with self.database.write() as session:
            row = self._find(session, self.id, lock=True)
            mine = select(ScanRow.id).where(ScanRow.scanner_id == self.id, ScanRow.state.not_in(_OVER))
            if left := list(session.scalars(mine.order_by(ScanRow.sequence))):
                raise InUse(f"{self.id} cannot be retired before its scans have ended: {', '.join(left)}")
            row.retired, row.since = self.clock(), self.clock()
            row.address, row.follows, row.lease_ends = None, False, None
            row.connection, row.state = "unknown", "idle"
            self._forget(row)
            self._event(session, row, who, "retired" + (f": {reason}" if reason else ""))

    def rows(self) -> list[ScannerRow]:
        """Return the rows of all scanners that are not decommissioned, by name."""
        with self.database.read() as session:
            return list(session.scalars(select(ScannerRow).where(PRESENT).order_by(ScannerRow.id)))

    def report(self, connection: str | None, state: str, error: str | None = None) -> None:
        """Store connection, activity and error of the scanner, and append an event if they changed.

        Parameters
        ----------
        connection
            State of the connection; ``None``: unchanged.
        state
            Activity of this service: ``idle``, ``scanning`` or ``paused``.
        error
            Present error of the scanner, or ``None``.
        """
        with self.database.write() as session:
            row = self._find(session, self.id, lock=True)
            connection = connection or row.connection
            if (row.connection, row.state, row.last_error) == (connection, state, error):
                return
            row.connection, row.state, row.since, row.last_error = connection, state, self.clock(), error
            self._event(session, row, "acquisition", error or state)

    def note_state(self, state: str) -> None:
        """Store the scanner's activity (idle, scanning, paused); no effect if the scanner does not exist."""
        with suppress(NotFound):
            self.report(None, state)

    def note_status(self, status: ScannerStatus) -> None:
        """Store the status that the scanner reported; changes are appended to the event log."""
        age = status.age()
        with self.database.write() as session:
            query = select(ScannerRow).where(ScannerRow.id == self.id).with_for_update()
            row = session.scalars(query).one_or_none()  # no scan ends because nobody can be told of its guards
            if row is None or row.retired is not None:
                return
            looked_at = None if age is None else self.clock() - timedelta(seconds=age)
            told: dict[str, Any] = {"interlock": status.interlock, "key_switch": status.key, "shutter": status.shutter}
            told |= {"laser": status.laser, "connection": status.connection, "port_holder": status.holder}
            told |= {"fault": status.fault, "last_error": status.error}
            told |= {"model": status.model or row.model, "serial": status.serial or row.serial}
            if wording(row.last_error) == wording(status.error):
                told["last_error"] = row.last_error
            changed = [name for name, value in told.items() if getattr(row, name) != value]
            if not changed:  # a time alone is no new revision
                session.execute(update(ScannerRow).where(ScannerRow.id == self.id).values(looked_at=looked_at))
                return
            if "connection" in changed:
                row.since = self.clock()
            for name in changed:
                setattr(row, name, told[name])
            row.looked_at = looked_at
            self._event(session, row, "acquisition", ", ".join(map(_told, changed, map(told.get, changed))))

    def note_cleared(self, who: str, fault: str, reason: str | None) -> None:
        """Append an event that a person has cleared the scanner's latched fault."""
        with self.database.write() as session:
            row = self._find(session, self.id, lock=True)
            self._event(session, row, who, f"fault cleared: {fault}" + (f": {reason}" if reason else ""))

    def _find(self, session: Session, identifier: str, *, lock: bool = False) -> ScannerRow:
        row = super()._find(session, identifier, lock=lock)
        if row.retired is not None:
            raise NotFound(self.kind, identifier)
        return row

    def _forget(self, row: ScannerRow) -> None:
        row.interlock = row.key_switch = row.shutter = row.laser = "unknown"
        row.fault = row.port_holder = row.looked_at = None

    def _event(self, session: Session, row: ScannerRow, who: str, why: str) -> None:
        stopped = row.stopped_at is not None
        data = {"connection": row.connection, "state": row.state, "emergency_stop": stopped, "who": who, "why": why}
        data |= {"interlock": row.interlock, "key": row.key_switch, "shutter": row.shutter, "laser": row.laser}
        append_event(session, self.clock(), "scanner", row.id, data)


def _told(name: str, value: Any) -> str:
    """Return a short text about a changed column, for the event log."""
    if name == "fault":
        return "no fault" if value is None else str(value["title"])
    return f"{name.replace('key_switch', 'key').replace('_', ' ')} {value or 'none'}"
