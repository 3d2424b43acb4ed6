"""Monitor of the scanner's port between scans: reports status to API and database, and executes emergency stops.

While no scan of this process has the port, a :class:`fabry_perot.Monitor` holds it. A scan gets the port lent; the
monitor is closed for it and opened again afterwards, however the scan ended. No failure in here ends the process or a
scan.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from typing import Final

import fabry_perot
from fabry_perot.host import HostTiming
from steradian.scans.acquisition.port_lending import LentPort, Port
from steradian.scans.acquisition.scanner_status import described, status_of
from steradian.scans.acquisition.scanner_status_recorder import ScannerStatusRecorder
from steradian.storage.data_dir.scanner_status import ScannerStatus, StatusBlock, wording

WRITE: Final = 0.1
"""Seconds between two writes of the status block."""
TEND: Final = 0.05
"""Seconds between two looks at whether the monitor should be open."""
OPENING: Final = 1.0
"""Seconds within which a monitor that was just opened need not have heard anything."""
STOP_WITHIN: Final = 1.5
"""Seconds within which a stop has to be confirmed."""
GIVEN_BACK: Final = 0.4
"""Seconds for which a stop waits for a scan that is being connected to give the port back."""
LOOKING: Final = HostTiming(hello_tries=16)
"""For how long a scanner is looked for at the start: four seconds, since some need two until they hear anything."""
_log = logging.getLogger(__name__)


class PortMonitor:
    """Monitor of the scanner's port in the acquisition process.

    Parameters
    ----------
    port
        Where the scanner is.
    block
        Where its state is written, at least every :data:`WRITE` seconds.
    note
        Called with the state when it has changed, for the database; may raise SQLAlchemyError.
    listens
        Whether the port is held between scans; if not, all is unknown between them.
    shared
        Whether other nodes know the scanner from the database, so that it is noted also without a change.
    """

    def __init__(
        self,
        port: Port,
        block: StatusBlock,
        note: Callable[[ScannerStatus], object],
        *,
        listens: bool = True,
        shared: bool = False,
    ) -> None:
        self._port, self._block, self._listens = port, block, listens
        self._notes = ScannerStatusRecorder(self.status, note, shared=shared)
        self._lent: LentPort | None = None
        self._monitor: fabry_perot.Monitor | None = None
        self._monitored, self._opened = "", 0.0
        self._model = self._serial = ""
        self._trouble: str | None = None
        """Why no monitor could be opened."""
        self._heard: ScannerStatus | None = None
        """What a connected scanner said last: it holds for a moment while the port changes hands."""
        self._stopped: tuple[fabry_perot.StopAnswer | None, float] = None, 0.0
        """What the scanner said after the last confirmed stop, and when."""
        self._told = ("", "")
        self._wanted = 0
        self._holding = threading.RLock()
        """Between opening, using and closing the monitor."""
        self._over = threading.Event()

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Run the monitor until the block ends, then release the port."""
        notes = partial(self._notes.run, self._over)
        work: dict[str, Callable[[], None]] = {
            "scanner-status": self._write,
            "scanner-monitor": self._tend,
            "scanner-notes": notes,
        }
        threads = [threading.Thread(target=each, name=name, daemon=True) for name, each in work.items()]
        for thread in threads:
            thread.start()
        try:
            yield
        finally:
            self._over.set()
            for thread in threads[:2]:  # the database may be away
                thread.join(STOP_WITHIN)
            self._close()

    @contextmanager
    def lent(self) -> Iterator[None]:
        """Release the port to a scan of this process until the block ends."""
        self._wanted += 1
        try:
            with self._holding:
                self._lent = LentPort()
                self._close()
        finally:
            self._wanted -= 1
        try:
            yield
        finally:
            self._lent = None

    @contextmanager
    def guarding(self, scanner: fabry_perot.Scanner) -> Iterator[None]:
        """Context manager during which the state of a scan's connected scanner is reported."""
        lent = self._lent = self._lent or LentPort()
        lent.scanner = scanner
        with suppress(fabry_perot.ScannerError):
            self._identify(scanner.capabilities.model, scanner.capabilities.serial)
        try:
            yield
        finally:
            lent.scanner, lent.may_fire, lent.is_over = None, False, True

    def may_fire(self, allowed: bool) -> None:
        """Record, before the command is sent, that a scan's scanner may fire, or afterwards that it no longer does."""
        if (lent := self._lent) is not None:
            lent.may_fire = allowed
            self._write_once()

    def stop(self, who: str) -> fabry_perot.StopAnswer | None:
        """Turn the laser off through the port and return the scanner's answer; ``None`` without a scanner.

        It is answered within two seconds, whoever holds the port; a connected scan of this process is stopped by its
        own connection instead.
        """
        waited = time.monotonic() + GIVEN_BACK
        while self._is_connecting and time.monotonic() < waited:
            time.sleep(TEND / 5)
        if (url := self._port.present()) is None:
            return None
        self._wanted += 1
        try:
            if (monitor := self._monitor) is not None:
                return monitor.stop(who, STOP_WITHIN)
            return fabry_perot.emergency_stop(url, timeout=STOP_WITHIN, who=who)
        finally:
            self._wanted -= 1

    @property
    def _is_connecting(self) -> bool:
        lent = self._lent
        return lent is not None and lent.scanner is None and not lent.is_over

    def clear_fault(self, wanted: Callable[[], bool] = lambda: True) -> str:
        """Clear the scanner's latched fault and return its name; empty when none is latched.

        Parameters
        ----------
        wanted
            Asked just before the fault is cleared, whether that is still wanted.

        Raises
        ------
        Conflict
            When a scan of this process has the scanner.
        FaultStands, ScannerUnreachable
            When it cannot be cleared.
        """
        from steradian.scans.acquisition.fault_clearing import clear_through

        with self._holding:
            return clear_through(self._monitor, self._port.present(), is_lent=self._lent is not None, wanted=wanted)

    def note_stop(self, answer: fabry_perot.StopAnswer) -> None:
        """Record the scanner's state after an emergency stop, which overrides earlier reports."""
        if answer.laser == "off":
            self._stopped = answer, time.monotonic()
            if (lent := self._lent) is not None:
                lent.may_fire = False  # it is ending
            self._write_once()

    def status(self) -> ScannerStatus:
        """Return the scanner's current state."""
        found, (answer, at) = self._present_status(), self._stopped
        if answer is None or found.heard is None or found.heard >= at or found.laser not in {"armed", "on"}:
            return found
        return replace(found, laser="off", shutter=answer.shutter, state=answer.state, heard=at)

    def _present_status(self) -> ScannerStatus:
        lent = self._lent
        if lent is not None:
            if lent.scanner is not None and (found := status_of(lent.scanner)) is not None:
                self._heard = replace(found, model=self._model, serial=self._serial)
            known = self._heard or ScannerStatus(model=self._model, serial=self._serial)
            return replace(known, laser="armed") if lent.may_fire and known.laser == "off" else known
        if self._port.present() is None:
            return ScannerStatus(laser="off", heard=time.monotonic())
        if (monitor := self._monitor) is not None:
            found = described(monitor)
            if found.heard is not None or time.monotonic() - self._opened > OPENING:
                self._heard = replace(found, model=self._model, serial=self._serial)
        if self._heard is not None and (self._monitor is not None or self._heard.as_of_now() is self._heard):
            return self._heard  # also for a moment while the port changes hands
        found = ScannerStatus(error=self._trouble, model=self._model, serial=self._serial)
        return replace(found, connection="disconnected") if self._trouble else found

    def _identify(self, model: str, serial: str) -> None:
        if (model, serial) != (self._model, self._serial):
            self._model, self._serial = model, serial
            _log.info("the scanner at %s is %s %s", self._port.present(), model, serial)

    def _write(self) -> None:
        while not self._over.wait(WRITE):
            self._write_once()

    def _write_once(self) -> None:
        try:
            self._block.write(self.status())
        except Exception:  # whatever it was, the next time comes; readers see that the block is old
            _log.exception("the scanner's state cannot be written")

    def _look_once(self) -> None:
        """Connect to the scanner once at the start, to identify its model; log a warning on failure."""
        url = self._port.present()
        if url is None:
            return
        try:
            with fabry_perot.connect(url, timing=LOOKING, recovery=None, cancelled=self._is_wanted) as scanner:
                self._identify(scanner.capabilities.model, scanner.capabilities.serial)
        except (fabry_perot.ScannerError, OSError, ValueError) as error:
            if not self._is_wanted():
                _log.warning("the scanner at %s was not found: %s", url, error)

    def _is_wanted(self) -> bool:
        """Return whether the monitor must release the port: a scan or stop needs it, or the monitor ends."""
        return self._over.is_set() or self._wanted > 0

    def _tend(self) -> None:
        with self._holding:
            try:
                self._look_once()
            except Exception:
                _log.exception("the search for the scanner failed")
        while not self._over.is_set():
            try:
                with self._holding:
                    self._open_or_close()
                self._log_state()
            except Exception as error:  # a monitor that fails ends no acquisition
                if self._trouble != str(error):
                    _log.exception("the scanner's port cannot be watched")
                self._trouble = str(error)
                self._over.wait(1.0)
            self._over.wait(TEND)

    def _open_or_close(self) -> None:
        url = self._port.present() if self._listens and self._lent is None and not self._over.is_set() else None
        if url != (self._monitored or None):
            self._close()
        if url is not None and self._monitor is None:
            self._opened = time.monotonic()
            self._monitor, self._monitored, self._trouble = fabry_perot.Monitor(url), url, None

    def _close(self) -> None:
        with self._holding:
            monitor, self._monitor, self._monitored = self._monitor, None, ""
            if monitor is not None:
                try:
                    monitor.close()
                except Exception:
                    _log.exception("the scanner's port cannot be closed in good order")

    def _log_state(self) -> None:
        """Log changes of the connection's state and error; not while a scan uses the port."""
        monitor = self._monitor
        if monitor is None:
            return
        status = described(monitor)
        is_new = time.monotonic() - self._opened < OPENING
        if (is_new and status.connection != "connected") or (
            now := (status.connection, wording(status.error))
        ) == self._told:
            return
        self._told = now
        if status.connection == "connected" and status.error is None:
            _log.info("the scanner at %s answers: %s", self._monitored, status.state)
        else:
            _log.warning("the scanner at %s is %s: %s", self._monitored, status.connection, status.error)
