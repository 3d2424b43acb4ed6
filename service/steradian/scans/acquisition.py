"""The acquisition process: ``python -m steradian.scans.acquisition`` runs queued scans, one at a time.

It is the only one that talks to the scanner and, but for the queueing, the only one that changes a scan's state. After
a restart every scan that was under way is ``interrupted``: the laser never starts by itself.
"""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from sqlalchemy.exc import DBAPIError

import fabry_perot
from steradian.errors import Cancelled, ScanFailed, SteradianError
from steradian.settings import Settings
from steradian.storage.database import Database, metadata_url
from steradian.storage.heartbeat import Heartbeat
from steradian.storage.job_process import end_with_stdin
from steradian.storage.logs import configure_logging
from steradian.storage.paths import DataDirectory
from steradian.storage.plans import PlanRepository
from steradian.storage.scanners import ScannerRepository
from steradian.storage.scans import ScanRepository
from steradian.storage.states import DesiredScanState, ScanState
from steradian.storage.tables import ScanRow

POLL = 0.2
"""Seconds between looks for work, at what is wished of a scan, and between progress reports."""
_S = ScanState
_log = logging.getLogger(__name__)


class ScannerPort:
    """Where the scanner is; a simulated one is started when first needed and again after it failed."""

    def __init__(self, settings: Settings) -> None:
        self._settings, self._stack, self._url = settings, ExitStack(), ""

    def url(self) -> str:
        """Return the port to connect to."""
        if not self._settings.simulated:
            return self._settings.scanner
        if not self._url:
            from fabry_perot.simulator import launch

            self._url = self._stack.enter_context(launch(speed=self._settings.simulator_speed)).url
        return self._url

    def close(self) -> None:
        """End a simulated scanner."""
        self._url = ""
        self._stack.close()


class Acquisition:
    """Takes queued scans and runs them.

    Parameters
    ----------
    scans, plans
        What to run.
    data
        Where the files go.
    port
        Where the scanner is.
    stopping
        Set when the service ends: the scan under way is made safe and left ``interrupted``.
    clock
        Seconds, to pace the reports.
    """

    def __init__(
        self,
        scans: ScanRepository,
        plans: PlanRepository,
        data: DataDirectory,
        port: ScannerPort,
        stopping: threading.Event,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._scans, self._plans, self._data, self._port = scans, plans, data, port
        self._stopping, self._clock = stopping, clock
        self._scanner = ScannerRepository(scans.database, scans.clock)

    def run(self) -> None:
        """Work until asked to stop; while the database does not answer, wait for it."""
        while not self._stopping.is_set():
            try:
                self._begin()
                while not self._stopping.wait(POLL):
                    self.step()
            except DBAPIError as error:
                _log.error("the database does not answer: %s", error.orig)
                self._stopping.wait(1.0)

    def _begin(self) -> None:
        interrupted = self._scans.interrupt_all("the service was restarted")
        if interrupted:
            _log.warning("interrupted by a restart: %s", ", ".join(interrupted))
        self._scanner.report("unknown", "idle")

    def step(self) -> None:
        """Do what there is to do: settle interrupted scans that are wished stopped, run the oldest queued one."""
        for row in self._scans.wished_settled():
            self._scans.transition(row.id, _S.PARTIAL, why=row.reason or "kept as it is", summary=self._figures(row.id))
        row_or_none = self._scans.next_queued()
        if row_or_none is None:
            return
        if row_or_none.desired_state is not DesiredScanState.RUNNING:
            who = row_or_none.wished_by or "acquisition"
            self._scans.transition(row_or_none.id, _S.ABORTED, why=row_or_none.reason or "not wanted any more", who=who)
            return
        if (refusal := self._scanner.refusal(row_or_none)) is not None:
            self._scans.transition(row_or_none.id, _S.ABORTED, why=refusal)
            return
        self._run(row_or_none)

    def _run(self, row: ScanRow) -> None:
        self._scans.transition(row.id, _S.ARMING, why="the scanner is free")
        self._scanner.report("connected", "scanning")
        watch = _Watch(self._scans, row.id, self._stopping, self._clock)
        try:
            self._measure(row, watch)
            watch.over()
            self._finish(row.id)
            self._scanner.report("connected", "idle")
        except Cancelled as error:
            watch.over()
            self._finish(row.id, str(error))
            self._scanner.report("connected", "idle")
        except ScanFailed as error:
            following = _S.FAILED if isinstance(error.__cause__, fabry_perot.PlanInvalid) else _S.INTERRUPTED
            self._give_up(row.id, following, error.code, str(error))
        except SteradianError as error:
            self._give_up(row.id, _S.FAILED, error.code, str(error))
        except DBAPIError:
            raise  # the laser is off; the scan is interrupted when the database is back
        except Exception as error:
            _log.exception("scan %s failed", row.id)
            self._give_up(row.id, _S.FAILED, "internal", f"{type(error).__name__}: {error}")

    def _measure(self, row: ScanRow, watch: _Watch) -> None:
        from steradian.scans.run import run_scan

        run_scan(
            self._plans.load(row.plan_id),
            self._port.url(),
            self._data.scan_file(row.id),
            scan_id=row.id,
            progress=watch.progress,
            cancelled=watch.cancelled,
        )

    def _finish(self, identifier: str, why: str = "every A-line is stored") -> None:
        """Lead a scan that ended in good order to the state that its present one asks for."""
        last: dict[ScanState, tuple[ScanState, ...]] = {
            _S.ARMING: (_S.RUNNING, _S.COMPLETING, _S.COMPLETE),
            _S.RUNNING: (_S.COMPLETING, _S.COMPLETE),
            _S.STOPPING: (_S.PARTIAL,),
            _S.ABORTING: (_S.ABORTED,),
        }
        figures = self._figures(identifier)
        present = self._scans.get(identifier).state
        if self._stopping.is_set() and figures.get("stored") != figures.get("points"):
            self._scans.transition(identifier, _S.INTERRUPTED, why="the service ended", summary=figures)
            return
        for following in last[present]:
            self._scans.transition(identifier, following, why=why, summary=figures)
        _log.info("scan %s is %s: %s", identifier, following, figures)

    def _give_up(self, identifier: str, following: ScanState, code: str, message: str) -> None:
        _log.error("scan %s is %s: %s", identifier, following, message)
        self._port.close()
        self._scanner.report("disconnected" if following is _S.INTERRUPTED else "connected", "idle", message)
        figures = self._figures(identifier)
        self._scans.transition(identifier, following, why=message, error=(code, message), summary=figures)

    def _figures(self, identifier: str) -> dict[str, Any]:
        return count_alines(self._data.scan_file(identifier))


class _Watch:
    """Between a running scan and its row: writes progress, reads wishes, both at most every :data:`POLL` seconds."""

    def __init__(
        self, scans: ScanRepository, identifier: str, stopping: threading.Event, clock: Callable[[], float]
    ) -> None:
        self._scans, self._id, self._stopping, self._clock = scans, identifier, stopping, clock
        self._written = self._asked = float("-inf")
        self._running = False
        self._last: tuple[str, int, int] | None = None
        self._answer = False

    def progress(self, stage: str, done: int, total: int) -> None:
        """Note how far the scan is; the first A-lines mean that it runs."""
        self._last = (stage, done, total)
        try:
            if not self._running:
                self._scans.transition(self._id, _S.RUNNING, why="the first A-lines are stored")
                self._running = True
            if self._clock() - self._written >= POLL:
                self._written = self._clock()
                self._scans.report(self._id, *self._last)
        except DBAPIError as error:  # the A-lines go on into the file
            _log.warning("progress of scan %s is lost: %s", self._id, error.orig)

    def cancelled(self) -> bool:
        """Whether the scan should end, because somebody wishes it or the service ends."""
        if self._answer or self._stopping.is_set():
            return True
        if self._clock() - self._asked < POLL:
            return False
        self._asked = self._clock()
        try:
            row = self._scans.get(self._id)
            if row.desired_state is not DesiredScanState.RUNNING:
                keep = row.desired_state is DesiredScanState.STOPPED and self._running
                following, who = _S.STOPPING if keep else _S.ABORTING, row.wished_by or "acquisition"
                self._scans.transition(self._id, following, why=row.reason or "requested", who=who)
                self._answer = True
        except DBAPIError as error:
            _log.warning("what is wished of scan %s cannot be read: %s", self._id, error.orig)
        return self._answer

    def over(self) -> None:
        """Write the last progress; waits for a database that does not answer."""
        while self._last is not None:
            stage, done, total = self._last
            self.progress(stage, done, total)
            try:
                return self._scans.report(self._id, stage, done, total)
            except DBAPIError:
                if self._stopping.wait(1.0):
                    return None
        return None


def count_alines(path: Path) -> dict[str, Any]:
    """Count what a scan file holds: ``points``, ``stored``, ``fired``; empty when there is no readable file."""
    import h5py
    import numpy as np

    from steradian.scans import schema

    try:
        with h5py.File(path, "r") as file:
            status = np.asarray(file["alines/status"])
            stored = int((status == schema.STORED).sum())
            return {"points": len(status), "stored": stored, "fired": int(file["fired"][()])}
    except (OSError, KeyError):
        return {}


def main() -> None:
    """Be the acquisition process of the service that the environment describes."""
    settings = Settings.create()
    configure_logging(settings, "acquisition")
    stopping = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopping.set())
    data, port = DataDirectory(settings.data), ScannerPort(settings)
    database = Database(metadata_url(settings))
    end = threading.Thread(target=end_with_stdin, args=(lambda: os.kill(os.getpid(), signal.SIGTERM),), daemon=True)
    with Heartbeat(data.heartbeat("acquisition")):
        end.start()
        try:
            ScannerRepository(database).ensure(simulated=settings.simulated)
            Acquisition(ScanRepository(database), PlanRepository(database), data, port, stopping).run()
        finally:
            port.close()
            database.close()


if __name__ == "__main__":
    main()
