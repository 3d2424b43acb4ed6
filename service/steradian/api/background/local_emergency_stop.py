"""Emergency stop of this node: sets the latch at once and records the stop in the database in a background thread."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable

from steradian.storage.data_dir.emergency_latch import EmergencyLatch, StopOutcome, StopPress
from steradian.storage.db.change_detector import MAX_IDLE_INTERVAL, ChangeDetector
from steradian.storage.db.tables import ScannerRow
from steradian.storage.repositories.scanner_lease_and_stop import EmergencyStopped, ScannerRepository

ANSWER_TIMEOUT = 1.8
"""Seconds for which the acquisition's answer is waited for: it asks the scanner for up to 1.5 s."""
SECOND_LOOK = 0.6
"""Seconds within which an unconfirmed answer may become a confirmed one: a connection that ends as it is asked."""
RECORD_TIMEOUT = 0.2
"""Seconds for which an answer waits until the stop stands in the database, too."""
MAX_RELAYED = 100
"""Presses of other nodes that are kept in mind."""
POLL_INTERVAL = 0.005
RECORD_INTERVAL = 1.0
"""Seconds between two looks at what is to be recorded."""
_log = logging.getLogger(__name__)


class EmergencyStopController:
    """Controller of this node's emergency stop: sets the latch without the database and records the stop in a thread.

    Parameters
    ----------
    latch
        Latch that the acquisition process reads.
    scanner
        Repository in which this node records the stop, and in which another node may have recorded one.
    """

    def __init__(self, latch: EmergencyLatch, scanner: ScannerRepository) -> None:
        self._latch, self._scanner = latch, scanner
        self._recorded = ""
        self._errands: dict[str, StopPress] = {}
        self._order = threading.Lock()
        """Between the record of a press and a release: what is in the database last is what happened last."""
        self._pressed, self._over = threading.Event(), threading.Event()

    def open(self) -> None:
        """Start the thread that records emergency stops in the database."""
        threading.Thread(target=self._run, name="emergency-record", daemon=True).start()

    def close(self) -> None:
        """Stop the recording thread; the next start of the service records pending stops."""
        self._over.set()
        self._pressed.set()

    @property
    def active(self) -> StopPress | None:
        """Active emergency stop, or None."""
        return self._latch.active()

    def outcome(self, press: StopPress) -> StopOutcome | None:
        """Return the acquisition process's acknowledgement of a stop, if any."""
        return self._latch.outcome(press.number)

    def is_recorded(self, press: StopPress) -> bool:
        """Return whether an emergency stop is recorded in the database."""
        return self._recorded == press.number

    async def press(
        self, who: str, reason: str | None, errand: str | None = None
    ) -> tuple[StopPress, StopOutcome | None]:
        """Set the emergency stop and wait briefly for the acquisition process's acknowledgement.

        Parameters
        ----------
        errand
            Number of a stop that another node relays, perhaps repeatedly: a released stop is not set again.
        """
        press = (self._errands.get(errand) if errand else None) or self._latch.press(who, reason, errand or None)
        if errand:
            self._errands[errand] = press
            if len(self._errands) > MAX_RELAYED:
                del self._errands[next(iter(self._errands))]
        self._pressed.set()
        began = time.monotonic()
        await wait_until(lambda: self.outcome(press) is not None, ANSWER_TIMEOUT)
        await wait_until(lambda: self._is_confirmed(press), min(SECOND_LOOK, began + ANSWER_TIMEOUT - time.monotonic()))
        self._pressed.set()  # what came of it is noted at once, too: other nodes know it from the database
        await wait_until(lambda: self.is_recorded(press), RECORD_TIMEOUT)
        return press, self.outcome(press)

    def _is_confirmed(self, press: StopPress) -> bool:
        deed = self.outcome(press)
        return deed is not None and deed.laser != "unconfirmed"

    def release(self, who: str, number: str | None = None, reason: str | None = None) -> None:
        """Release the emergency stop in the latch and then in the database.

        Parameters
        ----------
        who
            Name of the person.
        number
            Number of the stop to release; by default the active one.
        reason
            Reason of the release, for the event log.

        Raises
        ------
        EmergencyStopped
            When a stop other than ``number`` is active, or was pressed meanwhile.
        """
        with self._order:
            press = self._known(self._scanner.get(self._scanner.id))
            if press is not None and number is not None and press.number != number:
                raise EmergencyStopped(
                    f"{press.who} pressed the emergency stop since; check the state again before you release it"
                )
            if press is not None:
                self._latch.release(press.number)
            if (later := self.active) is not None:
                raise EmergencyStopped(f"{later.who} pressed the emergency stop while it was released")
            self._scanner.release_stop(who, reason)

    def _run(self) -> None:
        changes = ChangeDetector(self._scanner.database, MAX_IDLE_INTERVAL)
        while not self._over.is_set():
            try:
                if is_pressed := self._pressed.is_set():
                    self._pressed.clear()
                    self._latch.make_durable()
                if is_pressed or changes.has_changed() or self.active is not None:
                    self._record()
            except Exception as error:
                changes.reset()
                _log.warning("the emergency stop cannot be read from the database; the latch stays: %s", error)
                self._over.wait(RECORD_INTERVAL / 4)
            self._pressed.wait(RECORD_INTERVAL)

    def _record(self) -> None:
        """Reconcile latch and database: a stop that is active in either becomes active in both."""
        with self._order:
            row = self._scanner.get(self._scanner.id)
            press = self._known(row)
            if press is None or not press.number:
                return
            if press.number != self._recorded:
                if row.stop_number != press.number:
                    row = self._scanner.stop(press.who, press.reason, press.number)
                self._recorded = press.number
            deed = self.outcome(press)
            known = (row.stop_number, row.stop_laser, row.stop_detail)
            if deed is not None and known != (deed.number, deed.laser, deed.detail):
                self._scanner.record_stop_outcome(deed.number, deed.laser, deed.seconds, deed.detail)

    def _known(self, row: ScannerRow) -> StopPress | None:
        """Return the active stop, after setting the latch if only the database has a stop (other node, lost latch)."""
        if row.stopped_at is not None and self.active is None:
            self._latch.press(row.stopped_by or "", row.stop_reason, row.stop_number)
            if self.active is None:  # it was released here, and that did not reach the database
                self._latch.press(row.stopped_by or "", row.stop_reason)
        return self.active


async def wait_until(condition: Callable[[], bool], seconds: float) -> None:
    """Poll a condition until it holds or the timeout expires."""
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:  # noqa: ASYNC110 - another process or thread answers
        await asyncio.sleep(POLL_INTERVAL)
