"""Watchdog thread that switches the laser off while the emergency stop is active."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import fabry_perot
from steradian.core.logging_config import bind_request_id, request_id
from steradian.scans.acquisition.port_monitor import STOP_WITHIN, PortMonitor
from steradian.scans.acquisition.scanner_status import status_of
from steradian.storage.data_dir.emergency_latch import EmergencyLatch, StopOutcome, StopPress
from steradian.storage.data_dir.scanner_status import wording

POLL_INTERVAL: Final = 0.01
"""Seconds between two looks at the latch."""
AGAIN: Final = 0.25
"""Seconds after which a scanner is asked again that did not confirm the stop."""
LEAVING: Final = 0.2
"""Seconds for which a session that is being closed is waited for."""
LONGEST: Final = 500
"""Characters of an answer's sentence."""
_NO_SCANNER: Final = "there is no scanner: the simulated one is not running"
_log = logging.getLogger(__name__)


class EmergencyWatchdog:
    """Watchdog that switches the laser off while the emergency stop is active, independently of other threads.

    A connected scan is stopped by its own connection; without one the scanner is asked through its port, whoever holds
    that. While the stop stands, a scanner that fires again is stopped again.

    Parameters
    ----------
    latch
        Where the stop is pressed.
    port
        The scanner's port; ``None``: there is no scanner but the one of a scan.
    """

    def __init__(self, latch: EmergencyLatch, port: PortMonitor | None = None) -> None:
        self._latch, self._port = latch, port
        self._scanner: fabry_perot.Scanner | None = None
        self._cause = ""
        """The request that the scanner works for."""
        self._told: StopOutcome | None = None
        self._asked = float("-inf")
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="emergency-stop", daemon=True)

    @contextmanager
    def running(self) -> Iterator[None]:
        """Run the watchdog thread, which polls the emergency-stop latch, until the block ends."""
        self._thread.start()
        try:
            yield
        finally:
            self._over.set()
            self._thread.join()

    @property
    def standing(self) -> StopPress | None:
        """Active emergency stop; ``None`` if there is none."""
        return self._latch.active()

    @contextmanager
    def protect(self, scanner: fabry_perot.Scanner) -> Iterator[None]:
        """Context manager during which emergency stops switch off the laser of a connected scanner."""
        self._scanner, self._cause = scanner, request_id.get()
        try:
            if self._port is None:
                yield
            else:
                with self._port.guarding(scanner):
                    yield
        finally:
            self._scanner, self._cause = None, ""

    def may_fire(self, allowed: bool) -> None:
        """Record, before the command is sent, that the scanner may fire, or afterwards that it no longer does."""
        if self._port is not None:
            self._port.may_fire(allowed)

    def _run(self) -> None:
        while not self._over.is_set():
            time.sleep(POLL_INTERVAL)  # takes half of the processor time of Event.wait
            try:
                press = self._latch.active()
                if press is not None:
                    self._make_safe(press)
            except Exception:  # whatever it was, the next look comes
                _log.exception("the emergency stop cannot be read")

    def _make_safe(self, press: StopPress) -> None:
        scanner, cause, told = self._scanner, self._cause, self._told
        if told is None or told.number != press.number:
            told = self._told = self._latch.outcome(press.number)  # a former process may have answered
            self._asked = float("-inf")
        settled = told is not None and told.laser != "unconfirmed"
        if settled and not self._is_live(scanner):
            return
        if time.monotonic() - self._asked < AGAIN:
            return
        laser, detail = self._switch_off(scanner, press)
        self._asked = time.monotonic()
        passed = self._asked - press.moment  # another clock after a restart of the computer
        seconds = told.seconds if told is not None and settled else round(passed, 4) if passed >= 0 else None
        deed = StopOutcome(press.number, laser, seconds, detail[:LONGEST])
        if told is None or (deed.laser, wording(detail)) != (told.laser, wording(told.detail)):
            self._latch.record_outcome(deed)
        self._told = deed
        if told is None or deed.laser != told.laser:
            with bind_request_id(cause):
                _log.warning("%s, pressed by %s: laser %s; %s", press.why, press.who, laser, detail)

    def _is_live(self, scanner: fabry_perot.Scanner | None) -> bool:
        """Return whether the scanner's latest status says that it fires or may fire."""
        status = self._port.status() if self._port is not None else status_of(scanner) if scanner is not None else None
        return status is not None and status.as_of_now().laser in {"armed", "on"}

    def _has_left(self, scanner: fabry_perot.Scanner) -> bool:
        """Wait briefly for the scan to close its scanner connection, and return whether the connection is closed."""
        until = time.monotonic() + LEAVING
        while self._scanner is scanner and time.monotonic() < until:
            time.sleep(POLL_INTERVAL)
        return self._scanner is not scanner

    def _switch_off(self, scanner: fabry_perot.Scanner | None, press: StopPress) -> tuple[str, str]:
        """Turn the laser off; return the laser's state and the scanner's reply, or the reason of a failure."""
        who = f"{press.who}: {press.reason}" if press.reason else press.who
        answer: fabry_perot.StopAnswer | None = None
        try:
            if scanner is not None:
                answer = scanner.stop_laser(who, STOP_WITHIN)
                if answer.laser != "off" and self._has_left(scanner) and self._port is not None:
                    answer = self._port.stop(who)  # the session was sooner, and has closed the connection
            elif self._port is not None:
                answer = self._port.stop(who)
        except (fabry_perot.ScannerError, OSError) as error:
            return "unconfirmed", f"the scanner could not be asked: {error}; use the hardware switch"
        if answer is None:
            return "idle", _NO_SCANNER
        if self._port is not None:
            self._port.note_stop(answer)
        return answer.laser, answer.detail
