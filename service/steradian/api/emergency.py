"""The API's side of the emergency stop: pressed at once, noted in the database when that can be had."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable

from steradian.security.keys import KeyStore
from steradian.storage.emergency import Deed, EmergencyLatch, Press
from steradian.storage.scanners import SCANNER_ID, EmergencyStopped, ScannerRepository

PATIENCE = 1.0
"""Seconds for which the acquisition's answer is waited for; a lease ends within them."""
RECORDING = 0.2
"""Seconds for which an answer waits until the stop stands in the database, too."""
LOOK = 0.005
EVERY = 1.0
"""Seconds between two looks at what is to be recorded, and at the keys."""
_log = logging.getLogger(__name__)


class EmergencyDesk:
    """Takes presses of the stop without the database, the thread pool or another process; records them in a thread.

    Parameters
    ----------
    latch
        The stop.
    scanner, keys
        In the database: where it is recorded, and whose keys are kept in mind for a press without it.
    """

    def __init__(self, latch: EmergencyLatch, scanner: ScannerRepository, keys: KeyStore) -> None:
        self._latch, self._scanner, self._keys = latch, scanner, keys
        self._recorded = ""
        self._order = threading.Lock()
        """Between the record of a press and a release: what is in the database last is what happened last."""
        self._pressed, self._over = threading.Event(), threading.Event()

    def open(self) -> None:
        """Begin to record."""
        threading.Thread(target=self._run, name="emergency-record", daemon=True).start()

    def close(self) -> None:
        """Stop recording; what is not recorded is so at the next start."""
        self._over.set()
        self._pressed.set()

    @property
    def standing(self) -> Press | None:
        """The press that nobody has released, if there is one."""
        return self._latch.standing()

    def deed(self, press: Press) -> Deed | None:
        """Return what the acquisition did about a press, if it answered."""
        return self._latch.deed(press.number)

    def is_recorded(self, press: Press) -> bool:
        """Whether a press stands in the database."""
        return self._recorded == press.number

    async def press(self, who: str, reason: str | None) -> tuple[Press, Deed | None]:
        """Press the stop and wait a moment for what the acquisition says to it."""
        press = self._latch.press(who, reason)
        self._pressed.set()
        await _until(lambda: self.deed(press) is not None, PATIENCE)
        await _until(lambda: self.is_recorded(press), RECORDING)
        return press, self.deed(press)

    def release(self, who: str, number: str | None = None) -> None:
        """Release the stop, in the latch and then in the database.

        Parameters
        ----------
        who
            Who releases it.
        number
            The press to release; without it the one that stands now.

        Raises
        ------
        EmergencyStopped
            When another press stands than ``number``, or came meanwhile.
        """
        with self._order:
            press = self.standing
            if press is not None and number is not None and press.number != number:
                raise EmergencyStopped(
                    f"{press.who} pressed the emergency stop since; look again before you release it"
                )
            if press is not None:
                self._latch.release(press.number)
            if (later := self.standing) is not None:
                raise EmergencyStopped(f"{later.who} pressed the emergency stop while it was released")
            self._scanner.release_stop(who)

    def _run(self) -> None:
        try:
            self._take_over()
        except Exception:
            _log.exception("whether the emergency stop is recorded cannot be read; the latch holds")
        while not self._over.is_set():
            try:
                if self._pressed.is_set():
                    self._pressed.clear()
                    self._latch.make_durable()
                self._keys.remember()
                self._record()
            except Exception as error:
                _log.warning("the emergency stop or the keys cannot be looked at in the database: %s", error)
                self._over.wait(EVERY / 4)
            self._pressed.wait(EVERY)

    def _take_over(self) -> None:
        """Have the latch say what the database says: a folder whose latch was lost stays stopped."""
        row, press = self._scanner.get(SCANNER_ID), self.standing
        if row.stopped_at is None:
            return
        if press is None:
            press = self._latch.press(row.stopped_by or "", row.stop_reason)
        self._recorded = press.number

    def _record(self) -> None:
        with self._order:
            press = self.standing
            if press is not None and press.number and press.number != self._recorded:
                self._scanner.stop(press.who, press.reason)
                self._recorded = press.number


async def _until(condition: Callable[[], bool], seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:  # noqa: ASYNC110 - another process or thread answers
        await asyncio.sleep(LOOK)
