"""Acquisition process (``python -m steradian.runtime.acquisition``): runs queued scans, one at a time.

It is the only one that talks to the scanner and, but for the queueing, the only one that changes a scan's state. After
a restart every scan that was under way is ``interrupted``: the laser never starts by itself.
"""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import Any

from sqlalchemy.exc import DBAPIError

from fabry_perot import RecoveryPolicy
from steradian.core.child_process import exit_when_stdin_closes
from steradian.core.exceptions import DiskFull, FaultLatched, ScanFailed, ScanInterrupted, SteradianError
from steradian.core.logging_config import bind_request_id, configure_logging
from steradian.core.settings import Settings
from steradian.core.signal_safe_event import SignalSafeEvent
from steradian.plans import ScanPlan
from steradian.reconstructions.stages.planner import ChildStagePlanner
from steradian.runtime.archive.scan_uploader import ScanUploader
from steradian.runtime.heartbeat import Heartbeat
from steradian.runtime.scanner_address import ScannerConnection
from steradian.scans.acquisition.clear_fault_executor import ClearFaultExecutor
from steradian.scans.acquisition.database_control import POLL, DatabaseControl
from steradian.scans.acquisition.emergency_watchdog import EmergencyWatchdog
from steradian.scans.acquisition.port_monitor import PortMonitor
from steradian.scans.acquisition.resume_checks import ResumeRefused
from steradian.scans.acquisition.resumed_scan_file import create_from_partial
from steradian.scans.acquisition.run import ScanSummary, resume_scan, run_scan
from steradian.scans.acquisition.session import DEFAULT
from steradian.scans.acquisition.session_control import SessionOutcome
from steradian.scans.file.create import check_free_space, scan_file_bytes
from steradian.scans.file.stages import read_stages
from steradian.scans.summary import count_alines, scan_summary
from steradian.storage.blobs.interface import BlobStore, FolderBlobStore, scan_name
from steradian.storage.blobs.object_store import S3BlobStore, arrays_of
from steradian.storage.data_dir.emergency_latch import EmergencyLatch
from steradian.storage.data_dir.fault_requests import ClearFaultRequest
from steradian.storage.data_dir.layout import DataDirectory
from steradian.storage.data_dir.scanner_status import StatusBlock
from steradian.storage.db.change_detector import ChangeDetector
from steradian.storage.db.database import Database, metadata_url
from steradian.storage.db.tables import ScanRow
from steradian.storage.repositories.plans import PlanRepository
from steradian.storage.repositories.scan_stages import ScanStageRepository, has_further_stages
from steradian.storage.repositories.scanner_lease_and_stop import ScannerRepository
from steradian.storage.repositories.scans import ScanRepository
from steradian.storage.state_machines import DesiredScanState, ScanState, shortest_path

_S = ScanState
_LAST = {SessionOutcome.STOPPED: _S.PARTIAL, SessionOutcome.ENOUGH: _S.PARTIAL, SessionOutcome.ABORTED: _S.ABORTED}
RETRY_INTERVAL = 5.0
"""Seconds after which scans are read again although the database has not changed: an error may be over."""
_log = logging.getLogger(__name__)


class Acquisition:
    """Main loop of the acquisition process, which runs and resumes queued scans.

    Parameters
    ----------
    scans, plans
        Repositories of scans and plans.
    data
        Data directory of the scan files.
    port
        Port of the scanner.
    stopping
        Event set when the service ends: the running scan is made safe and left ``interrupted``.
    recovery
        Policy for resuming a scan without a person after an interruption.
    arrays
        Blob store with the A-lines of ended scans; by default ``data``.
    listens
        Whether the scanner's port stays open between scans, to receive status messages.
    shared
        Whether other nodes read the scanner's status from the database.
    """

    def __init__(
        self,
        scans: ScanRepository,
        plans: PlanRepository,
        data: DataDirectory,
        port: ScannerConnection,
        stopping: threading.Event,
        recovery: RecoveryPolicy = DEFAULT,
        arrays: BlobStore | None = None,
        *,
        listens: bool = True,
        shared: bool = False,
    ) -> None:
        self._scans, self._plans, self._data, self._port = scans, plans, data, port
        self._stopping, self._recovery = stopping, recovery
        self._arrays = arrays or FolderBlobStore(data)
        self._scanner = ScannerRepository(scans.database, scans.clock, scans.scanner_id)
        block = StatusBlock(data.emergency)
        self._watch = PortMonitor(port, block, self._scanner.note_status, listens=listens, shared=shared)
        self._emergency = EmergencyWatchdog(EmergencyLatch(data.emergency), self._watch)
        self._faults = ClearFaultExecutor(ClearFaultRequest(data.emergency), self._watch)

    def run(self, prepare: Callable[[], object] = lambda: None) -> None:
        """Run scans until ``stopping`` is set, retrying while the database is unavailable.

        The emergency stop works without the database. ``prepare`` is called before any scan.
        """
        with self.watching():
            self._work(prepare)

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Monitor the scanner's port, the emergency stop and fault-clearing requests until the block ends."""
        with self._watch.watching(), self._emergency.running(), self._faults.working():
            yield

    def _work(self, prepare: Callable[[], object]) -> None:
        while not self._stopping.is_set():
            try:
                prepare()
                self._begin()
                changes = ChangeDetector(self._scans.database, RETRY_INTERVAL)
                while not self._stopping.wait(POLL):
                    if changes.has_changed():
                        self.run_once()
            except DBAPIError as error:
                _log.error("the database does not answer: %s", error.orig)
                self._stopping.wait(1.0)

    def _begin(self) -> None:
        interrupted = self._scans.interrupt_all("the service was restarted")
        if interrupted:
            _log.warning("interrupted by a restart: %s", ", ".join(interrupted))
        self._scans.clear_desired_running("the service was restarted")
        self._scanner.report("unknown", "idle")

    def run_once(self) -> None:
        """End interrupted scans that are to stop, then resume or start at most one scan."""
        for row in self._scans.to_settle():
            self._settle(row)
        found, begin = self._scans.to_resume(), self._resume
        if found is None:
            found, begin = self._scans.next_queued(), self._begin_scan
        if found is not None:
            with bind_request_id(found.request_id):
                begin(found)

    def _settle(self, row: ScanRow) -> None:
        """Change an interrupted scan to partial, with the A-lines stored so far.

        If the local file is lost, the stored copy counts. Errors are logged and retried later.
        """
        try:
            self._note_stages(row)
            figures = scan_summary(self._arrays, self._data.scan_file(row.id), row.id)
            self._scans.transition(row.id, _S.PARTIAL, why=row.reason or "kept as it is", summary=figures)
        except (SteradianError, OSError) as error:
            _log.warning("scan %s cannot be ended yet: %s", row.id, error)

    def _note_stages(self, row: ScanRow) -> None:
        """Store the stages that the scan file has, if a process was killed before it could."""
        from steradian.reconstructions.scan_plan_reader import read_stored_plan  # with h5py

        path = self._data.scan_file(row.id)
        if row.stages is not None and path.exists():
            ScanStageRepository(self._scans.database, self._scans.clock).set_made(
                row.id, read_stages(path), read_stored_plan(path).plan
            )

    def _begin_scan(self, row: ScanRow) -> None:
        if row.desired_state is not DesiredScanState.RUNNING:
            who = row.wished_by or "acquisition"
            self._scans.transition(row.id, _S.ABORTED, why=row.reason or "not wanted any more", who=who)
            return
        if (refusal := self._refusal(row)) is not None:
            self._scans.transition(row.id, _S.ABORTED, why=refusal)
            return
        warning = self._disk_warning(row)
        self._scans.transition(row.id, _S.ARMING, why="the scanner is free" + (f"; {warning}" if warning else ""))
        self._run(row)

    def _refusal(self, row: ScanRow) -> str | None:
        """Return the reason why a scan must not fire (emergency stop, other lease), or ``None``."""
        stopped = self._emergency.standing is not None
        return "the emergency stop is pressed" if stopped else self._scanner.refusal_reason(row)

    def _loss(self, row: ScanRow) -> str | None:
        """Return an error text if the file of an interrupted scan is missing on this node, or ``None``."""
        if row.started is None or self._data.scan_file(row.id).exists():
            return None
        return "the file with its A-lines is not in this node's folder"

    def _disk_warning(self, row: ScanRow) -> str | None:
        """Return a warning if the scan will nearly fill the disk, or ``None``."""
        try:
            return check_free_space(self._data.scan_file(row.id).parent, scan_file_bytes(self._plans.load(row.plan_id)))
        except DiskFull:
            return None

    def _resume(self, row: ScanRow) -> None:
        why = row.reason or "resumed"
        self._scans.transition(row.id, _S.ARMING, why=why, who=row.wished_by or "acquisition")
        if (refusal := self._refusal(row) or self._loss(row)) is not None:
            self._scans.transition(row.id, _S.INTERRUPTED, why=refusal, error=("resume-refused", refusal))
            return
        self._run(row)

    def _run(self, row: ScanRow) -> None:
        """Run an armed scan until it ends or is interrupted, with exclusive use of the scanner's port."""
        self._scanner.report(None, "scanning")
        with self._watch.lent():
            self._take(row)

    def _take(self, row: ScanRow) -> None:
        watch = DatabaseControl(self._scans, row.id, self._stopping, self._emergency)
        try:
            try:
                summary = self._measure(row, watch)
                watch.flush()
            finally:
                watch.close()
            self._finish(row.id, summary.end, watch.enough)
            self._scanner.report("connected", "idle")
        except FaultLatched as error:
            how = f" (POST /api/v1/scanners/{self._scanner.id}/clear-fault) and resume the scan"
            self._give_up(row.id, _S.INTERRUPTED, error.code, f"{error}{how}", link_is_well=True)
        except (ResumeRefused, ScanInterrupted) as error:
            self._give_up(row.id, _S.INTERRUPTED, error.code, str(error), link_is_well=True)
        except ScanFailed as error:
            self._give_up(row.id, _S.INTERRUPTED, error.code, str(error))
        except SteradianError as error:
            self._give_up(row.id, _S.FAILED, error.code, str(error))
        except DBAPIError:
            raise  # the laser is off; the scan is interrupted when the database is back
        except Exception as error:
            _log.exception("scan %s failed", row.id)
            self._give_up(row.id, _S.FAILED, "internal", f"{type(error).__name__}: {error}")

    def _measure(self, row: ScanRow, watch: DatabaseControl) -> ScanSummary:
        plan, path = self._plans.load(row.plan_id), self._data.scan_file(row.id)
        with self._stage_planner(plan) as planner:
            return self._measure_plan(row, plan, path, watch, planner)

    def _stage_planner(self, plan: ScanPlan) -> AbstractContextManager[ChildStagePlanner | None]:
        """Return a planner of stages in a process of its own, if the plan has further stages or a stopping rule."""
        return ChildStagePlanner() if plan.stages or plan.stopping is not None else nullcontext()

    def _measure_plan(
        self, row: ScanRow, plan: ScanPlan, path: Path, watch: DatabaseControl, planner: ChildStagePlanner | None
    ) -> ScanSummary:
        how: dict[str, Any] = {"control": watch, "recovery": self._recovery, "planner": planner}
        if row.completes is not None and not path.exists():
            create_from_partial(self._arrays.open(scan_name(row.completes)), path, row.id)
        if path.exists():
            summary = resume_scan(path, self._port.url(), plan=plan, **how)
            if summary.findings:
                _log.info("scan %s is resumed: %s", row.id, "; ".join(map(str, summary.findings)))
            return summary
        return run_scan(plan, self._port.url(), path, scan_id=row.id, **how)

    def _finish(self, identifier: str, end: SessionOutcome, enough: str = "") -> None:
        """Change a scan that ended without an error to its terminal state: complete, partial or aborted.

        With ``enough``, the reason of its stopping rule, it is partial.
        """
        figures = self._figures(identifier)
        self._note_stages(self._scans.get(identifier))
        row = self._scans.get(identifier)
        whole = bool(figures) and figures["stored"] == figures["points"] and not has_further_stages(row)
        last = _S.COMPLETE if end is SessionOutcome.COMPLETE or whole else _LAST[end]
        if last is not _S.COMPLETE and self._stopping.is_set():
            self._scans.transition(identifier, _S.INTERRUPTED, why="the service ended", summary=figures)
            return
        is_empty = figures.get("stored") == 0 or not self._data.scan_file(identifier).exists()
        if last is _S.PARTIAL and is_empty:
            last = _S.ABORTED  # there is nothing to keep
        press = self._emergency.standing
        early = press.why if press else enough or row.reason or "requested"
        why = "every A-line is stored" if last is _S.COMPLETE else early
        for following in shortest_path(row.state, last):
            self._scans.transition(identifier, following, why=why, summary=figures)
        _log.info("scan %s holds %s", identifier, figures)

    def _give_up(
        self, identifier: str, following: ScanState, code: str, message: str, *, link_is_well: bool = False
    ) -> None:
        _log.error("scan %s is %s: %s", identifier, following, message)
        if not link_is_well:
            self._port.close()
        lost = following is _S.INTERRUPTED and not link_is_well
        self._scanner.report("disconnected" if lost else "connected", "idle", message if lost else None)
        figures = self._figures(identifier)
        self._scans.transition(identifier, following, why=message, error=(code, message), summary=figures)

    def _figures(self, identifier: str) -> dict[str, Any]:
        return count_alines(self._data.scan_file(identifier))


def main() -> None:
    """Run the acquisition process with settings from environment variables."""
    settings = Settings.create()
    configure_logging(settings, "acquisition")
    stopping = SignalSafeEvent()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopping.set())
    data, port = DataDirectory(settings.data), ScannerConnection(settings)
    database = Database(metadata_url(settings))
    terminate = partial(os.kill, os.getpid(), signal.SIGTERM)
    end = threading.Thread(target=exit_when_stdin_closes, args=(terminate,), daemon=True)
    with Heartbeat(data.heartbeat("acquisition")):
        end.start()
        try:
            scans, plans = ScanRepository(database, scanner_id=settings.scanner_id), PlanRepository(database)
            recovery = RecoveryPolicy(within=settings.resume_within)
            if isinstance(store := arrays_of(settings, database), S3BlobStore):
                threading.Thread(target=ScanUploader(store, scans, data).run, args=(stopping,), daemon=True).start()
            how = {"listens": settings.scanner_watch, "shared": settings.role != "service"}
            note = ScannerRepository(database, scanner_id=settings.scanner_id).ensure
            work = Acquisition(scans, plans, data, port, stopping, recovery, store, **how)
            simulated, follows = settings.simulated, settings.is_scanner_node
            work.run(lambda: note(simulated=simulated, address=settings.address, follows=follows))
        finally:
            port.close()
            database.close()


if __name__ == "__main__":
    main()
