"""The acquisition's own look at the emergency stop, in a thread that waits for nothing else."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import fabry_perot
from fabry_perot.wire.states import RUNNING, DeviceState
from steradian.logs import caused_by, request_id
from steradian.storage.emergency import Deed, EmergencyLatch, Press

LOOK = 0.01
"""Seconds between two looks at the latch."""
_log = logging.getLogger(__name__)
_LIVE = frozenset(state.name.lower() for state in (*RUNNING, DeviceState.ARMED))


class EmergencyWatch:
    """Switches the laser off while the stop stands, whatever the rest of the process is waiting for.

    Parameters
    ----------
    latch
        Where the stop is pressed.
    """

    def __init__(self, latch: EmergencyLatch) -> None:
        self._latch = latch
        self._scanner: fabry_perot.Scanner | None = None
        self._cause = ""
        """The request that the scanner works for."""
        self._told: Deed | None = None
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="emergency-stop", daemon=True)

    @contextmanager
    def looking(self) -> Iterator[None]:
        """Look at the latch until the block ends."""
        self._thread.start()
        try:
            yield
        finally:
            self._over.set()
            self._thread.join()

    @property
    def standing(self) -> Press | None:
        """The press that nobody has released, if there is one."""
        return self._latch.standing()

    @contextmanager
    def guarding(self, scanner: fabry_perot.Scanner) -> Iterator[None]:
        """Answer for a connected scanner until the block ends."""
        self._scanner, self._cause = scanner, request_id.get()
        try:
            yield
        finally:
            self._scanner, self._cause = None, ""

    def _run(self) -> None:
        while not self._over.wait(LOOK):
            try:
                press = self._latch.standing()
                if press is not None:
                    self._make_safe(press)
            except Exception:  # whatever it was, the next look comes
                _log.exception("the emergency stop cannot be looked at")

    def _make_safe(self, press: Press) -> None:
        scanner, cause, told = self._scanner, self._cause, self._told
        if told is None or told.number != press.number:
            told = self._told = self._latch.deed(press.number)  # a former process may have answered
        settled = told is not None and told.laser != "unconfirmed"
        if settled and (scanner is None or scanner.state not in _LIVE):
            return
        laser = "idle" if scanner is None else _switch_off(scanner)
        passed = time.monotonic() - press.moment  # another clock after a restart of the computer
        self._told = Deed(press.number, laser, round(passed, 4) if passed >= 0 else None)
        if not settled:
            self._latch.answer(self._told)
            with caused_by(cause):
                _log.warning("%s, pressed by %s: laser %s", press.why, press.who, laser)


def _switch_off(scanner: fabry_perot.Scanner) -> str:
    with suppress(fabry_perot.ScannerError, OSError):
        scanner.abort("laser-off")
        return "off"
    return "unconfirmed" if scanner.state in _LIVE else "off"  # the session was sooner, and has closed the connection
