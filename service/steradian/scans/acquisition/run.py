"""Execution of a scan plan on a scanner, and resumption of incomplete scans."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import fabry_perot
from fabry_perot import RecoveryPolicy
from steradian.core.exceptions import Cancelled, Conflict, FaultLatched, InvalidInput, ScanFailed, ScanInterrupted
from steradian.core.progress import CancelCheck, Progress
from steradian.plans import ScanPlan
from steradian.plans.stages import Points
from steradian.scans.acquisition.end_requests import EndedByRequest, ending_wish, hearing
from steradian.scans.acquisition.resume_checks import (
    Check,
    Tolerance,
    check_identity,
    check_reference_point,
    compare_tuning,
    record_tuning,
    require_all,
)
from steradian.scans.acquisition.scanner_checks import check_scanner
from steradian.scans.acquisition.session import DEFAULT, ScanSession
from steradian.scans.acquisition.session_control import (
    TERMINAL_COMMANDS,
    Command,
    SessionControl,
    SessionOutcome,
)
from steradian.scans.acquisition.stages import (
    StagePlanner,
    acquire_stage,
    check_stage_arguments,
    measure_further_stages,
    rows_of_stage,
)
from steradian.scans.acquisition.stopping import stopping_monitor
from steradian.scans.file.create import check_free_space, create_scan_file, scan_file_bytes
from steradian.scans.file.h5py_errors import reraise_as_damaged
from steradian.scans.file.locking import open_for_reading
from steradian.scans.file.measurement_order import ScanProgram
from steradian.scans.file.stages import read_stages
from steradian.scans.file.verify import CheckReport, verify_scan_file
from steradian.scans.file.writer import ScanFileWriter

_log = logging.getLogger(__name__)
RETRY_FLAGS = 0xF
"""Quality flags of an A-line worth measuring again: saturated, mistuned, misfire, partial average."""


@dataclass(frozen=True)
class ScanSummary:
    """Summary of a scan: file, A-line counts and outcome.

    Attributes
    ----------
    path
        The scan file.
    points, stored
        A-lines it is to hold, of all frames, and those it holds.
    fired
        Shots fired for it, in all sessions.
    end
        How the last session ended.
    rescued
        A-lines that a session that was killed had left in the scanner.
    findings
        What was compared before the scan was continued.
    """

    path: Path
    points: int
    fired: int
    stored: int
    end: SessionOutcome = SessionOutcome.COMPLETE
    rescued: int = 0
    findings: tuple[Check, ...] = field(default=())


def run_scan(
    plan: ScanPlan,
    scanner_url: str,
    path: Path,
    *,
    scan_id: str = "",
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
    control: SessionControl | None = None,
    recovery: RecoveryPolicy = DEFAULT,
    planner: StagePlanner | None = None,
    chosen: Points = (),
) -> ScanSummary:
    """Measure every point of a plan and store the A-lines in a new scan file.

    Each batch is on the disk before it is acknowledged, so the scanner keeps whatever the file does not hold yet.

    Parameters
    ----------
    plan
        What to measure.
    scanner_url
        Port of the scanner: ``/dev/ttyUSB0``, ``socket://host:port``, …
    path
        The scan file to make.
    progress, cancelled
        Reported and asked once a batch; the unit of progress is the A-line.
    control
        Instead of both: who may also pause and stop the scan.
    recovery
        What interruptions it survives, and how soon after them the laser may come back by itself.
    planner
        Computation of further stages; needed for a plan that has some.
    chosen
        Points of interest of the second stage, if they are known already.

    Raises
    ------
    Conflict
        When ``path`` exists.
    DiskFull
        When the disk cannot hold the scan; no file is made.
    InvalidInput
        When the scanner cannot do what the plan asks.
    Cancelled
        When ``cancelled`` said so; the laser is off and the file holds what was measured.
    ScanFailed
        When the scanner or its link gave up; likewise. A :class:`ScanInterrupted` waits for a person to resume it.
    """
    if path.exists():
        raise Conflict(f"{path} exists; choose another name or remove it")
    check_stage_arguments(plan, planner, chosen)
    path.parent.mkdir(parents=True, exist_ok=True)
    if (warning := check_free_space(path.parent, scan_file_bytes(plan))) is not None:
        _log.warning("%s", warning)
    starter = control or SessionControl(progress, cancelled)
    try:
        with _connected_scanner(scanner_url, recovery, starter) as scanner:
            model = scanner.capabilities
            check_scanner(plan, model)
            create_scan_file(
                path,
                plan,
                scan_id=scan_id,
                scanner=model.serial,
                scanner_model=model.model,
                simulated=model.simulated,
                pulse_energy=model.pulse_energy,
                film=model.film,
            )
            with ScanFileWriter(path) as store:
                with hearing(scanner, starter):
                    record_tuning(scanner, store)
                session = ScanSession(scanner, store, starter, recovery.within)
                with stopping_monitor(path, plan, planner) as enough:
                    end = acquire_stage(session, store, plan, starter, enough)
            if end is SessionOutcome.COMPLETE:
                end = measure_further_stages(scanner, path, plan, starter, recovery.within, planner, chosen)
            with ScanFileWriter(path) as store:
                return _summary(store, end, asked=control is not None)
    except EndedByRequest as error:
        return _given_up(path, ScanProgram.of_plan(plan).count, error.wish, asked=control is not None)


def resume_scan(
    path: Path,
    scanner_url: str,
    *,
    plan: ScanPlan | None = None,
    retry: int = 0,
    tolerance: Tolerance | None = None,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
    control: SessionControl | None = None,
    recovery: RecoveryPolicy = DEFAULT,
    planner: StagePlanner | None = None,
    chosen: Points = (),
) -> ScanSummary:
    """Resume an incomplete scan in the same file by measuring the missing points.

    Before a point is measured the scan proves that it is the same: plan, scanner and tuning, and a reference point
    that is measured again. A-lines that the scanner still holds from a session that was killed come in first.

    Parameters
    ----------
    path
        The scan file.
    scanner_url, progress, cancelled, control, recovery, planner
        As of :func:`run_scan`.
    plan
        Must be the file's or that of an earlier stage, if it is given.
    chosen
        Points of interest of the next stage, if a person has chosen them.
    retry
        Quality flags (:data:`RETRY_FLAGS`: any): stored A-lines with one of them are measured again, too.
    tolerance
        What may have changed.

    Raises
    ------
    DamagedFile
        When ``path`` is no scan file, or damaged beyond its A-lines.
    ResumeRefused
        A :class:`Conflict` that names every difference; nothing was fired but for the reference point.
    InvalidInput, Cancelled, ScanFailed
        As of :func:`run_scan`.
    """
    allowed = tolerance or Tolerance()
    report = verify_scan_file(path, progress=progress)
    starter = control or SessionControl(progress, cancelled)
    asked, course = control is not None, _plan_of(path)
    check_stage_arguments(course, planner, chosen)
    starter.on_stages(read_stages(path), course)
    try:
        with _connected_scanner(scanner_url, recovery, starter) as scanner:
            with ScanFileWriter(path) as store:
                findings = check_identity(store, plan, scanner.capabilities)
                require_all(findings)
                session = ScanSession(scanner, store, starter, recovery.within)
                rescued = session.drain_previous_upload()
                wanted = rows_of_stage(store, course) | store.flagged(retry)
                if not (wanted.any() or course.stages):
                    return _summary(store, SessionOutcome.COMPLETE, rescued, findings)
                with hearing(scanner, starter):
                    if (wish := starter.command()) not in TERMINAL_COMMANDS:
                        findings += compare_tuning(scanner, store, allowed)
                        require_all(findings)
                        wish = starter.command()
                    if wish in TERMINAL_COMMANDS:  # what the disk did not take is still in the scanner
                        return _summary(store, _end_of(wish), rescued, findings, asked=asked)
                    findings += _compare_reference(scanner, store, report, allowed, starter)
                require_all(findings)
                with stopping_monitor(path, course, None if retry else planner) as enough:
                    end = acquire_stage(session, store, course, starter, enough, store.flagged(retry))
            if end is SessionOutcome.COMPLETE:
                end = measure_further_stages(scanner, path, course, starter, recovery.within, planner, chosen)
            with ScanFileWriter(path) as store:
                return _summary(store, end, rescued, findings, asked=asked)
    except EndedByRequest as error:
        return _given_up(path, report.rows, error.wish, asked=asked)


def needs_planner(path: Path) -> bool:
    """Return whether the plan of a scan file has further stages or a stopping rule; False without a file."""
    if not path.is_file():
        return False
    plan = _plan_of(path)
    return bool(plan.stages) or plan.stopping is not None


def _plan_of(path: Path) -> ScanPlan:
    from steradian.scans.importing.untrusted_plan_reader import read_plan

    with reraise_as_damaged(path, "scan"), open_for_reading(path) as file:
        return read_plan(file)


def _compare_reference(
    scanner: fabry_perot.Scanner,
    store: ScanFileWriter,
    report: CheckReport,
    allowed: Tolerance,
    starter: SessionControl,
) -> list[Check]:
    """Re-measure the reference point with the laser firing, and compare it with the stored A-line."""
    starter.may_fire(True)
    try:
        return check_reference_point(scanner, store, report, allowed)
    finally:
        starter.may_fire(False)


@contextmanager
def _connected_scanner(url: str, recovery: RecoveryPolicy, starter: SessionControl) -> Iterator[fabry_perot.Scanner]:
    """Context manager of a monitored scanner connection that translates driver errors to service errors."""
    scanner: fabry_perot.Scanner | None = None
    try:
        with ExitStack() as stack:
            scanner = fabry_perot.connect(url, recovery=recovery, cancelled=lambda: ending_wish(starter) is not None)
            stack.enter_context(starter.monitor(scanner))
            stack.enter_context(scanner)
            require_no_fault(scanner)
            yield scanner
    except fabry_perot.PlanInvalid as error:
        raise InvalidInput(error.field, error.value, error.allowed) from error
    except fabry_perot.ScannerError as error:
        wish = ending_wish(starter)
        if wish is Command.ABORT or (wish is not None and scanner is None):
            raise EndedByRequest(wish) from error
        if scanner is not None:
            require_no_fault(scanner, error)
        if isinstance(error, fabry_perot.LeaseExpired | fabry_perot.DeviceRestarted | fabry_perot.ScanAborted):
            raise ScanInterrupted(f"{error}; resume the scan when the laser may fire again") from error
        raise ScanFailed(str(error)) from error


def require_no_fault(scanner: fabry_perot.Scanner, cause: Exception | None = None) -> None:
    """Raise FaultLatched if the scanner has a latched fault or emergency stop, which a person must clear."""
    if scanner.state in {"fault", "estop"}:
        code = scanner.status.fault if scanner.state == "fault" else 0
        fault = fabry_perot.fault_codes.by_code(code)
        raise FaultLatched(code, f"{fault}; {fault.remedy}, then clear the fault") from cause


def _end_of(wish: Command) -> SessionOutcome:
    return SessionOutcome.ABORTED if wish is Command.ABORT else SessionOutcome.STOPPED


def _given_up(path: Path, points: int, wish: Command, *, asked: bool) -> ScanSummary:
    """Return the summary of a session that was ended before the scanner had answered."""
    if path.exists():
        with ScanFileWriter(path) as store:
            return _summary(store, _end_of(wish), asked=asked)
    if not asked:
        raise Cancelled("the scan was stopped before it began; nothing is written")
    return ScanSummary(path, points, 0, 0, _end_of(wish))


def _summary(
    store: ScanFileWriter,
    end: SessionOutcome,
    rescued: int = 0,
    findings: list[Check] | None = None,
    *,
    asked: bool = True,
) -> ScanSummary:
    if end not in (SessionOutcome.COMPLETE, SessionOutcome.ENOUGH) and not asked:
        raise Cancelled(f"the scan was stopped after {store.stored} of {store.count} A-lines; they are kept")
    return ScanSummary(store.path, store.count, store.fired, store.stored, end, rescued, tuple(findings or ()))
