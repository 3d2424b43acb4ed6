"""Running a plan on a scanner."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import fabry_perot
from steradian.errors import Cancelled, Conflict, InvalidInput, ScanFailed
from steradian.plans import ScanPlan
from steradian.progress import IsCancelled, Progress
from steradian.scans.store import AlineStore, create_scan_file


@dataclass(frozen=True)
class ScanSummary:
    """What a scan came to."""

    path: Path
    points: int
    fired: int
    stored: int


def run_scan(
    plan: ScanPlan,
    scanner_url: str,
    path: Path,
    *,
    scan_id: str = "",
    progress: Progress | None = None,
    cancelled: IsCancelled | None = None,
) -> ScanSummary:
    """Measure every point of a plan and keep the A-lines in a scan file.

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

    Raises
    ------
    Conflict
        When ``path`` exists.
    InvalidInput
        When the scanner cannot do what the plan asks; no file is made.
    Cancelled
        When ``cancelled`` said so; the laser is off and the file holds what was measured.
    ScanFailed
        When the scanner or its link gave up; likewise.
    """
    if path.exists():
        raise Conflict(f"{path} exists; choose another name or remove it")
    try:
        with fabry_perot.connect(scanner_url) as scanner:
            _upload(plan, scanner)
            model = scanner.capabilities
            create_scan_file(path, plan, scan_id=scan_id, scanner=model.serial, simulated=model.simulated)
            with AlineStore(path) as store:
                fired = _acquire(scanner, store, progress, cancelled)
                return ScanSummary(path, plan.mask.count, fired, store.stored)
    except fabry_perot.PlanInvalid as error:
        raise InvalidInput(error.field, error.value, error.allowed) from error
    except fabry_perot.ScannerError as error:
        raise ScanFailed(str(error)) from error


def _upload(plan: ScanPlan, scanner: fabry_perot.Scanner) -> None:
    scanner.upload(
        plan.mask.film_positions[plan.visit],
        samples=plan.samples,
        sampling_interval=plan.sampling_interval,
        pulse_rate=plan.pulse_rate,
        averages=plan.averages,
    )


def _acquire(
    scanner: fabry_perot.Scanner, store: AlineStore, progress: Progress | None, cancelled: IsCancelled | None
) -> int:
    """Run the uploaded plan to its end; returns the shots fired for it."""
    before = scanner.status.shots
    scanner.start(scanner.arm())
    try:
        while not _take_alines(scanner, store, before, progress, cancelled):
            scanner.resume()  # this process was held up for longer than the laser's lease: nothing is lost
    finally:
        store.set_fired(max(0, scanner.status.shots - before))
    fired = scanner.report().fired
    store.set_fired(fired)
    return fired


def _take_alines(
    scanner: fabry_perot.Scanner,
    store: AlineStore,
    before: int,
    progress: Progress | None,
    cancelled: IsCancelled | None,
) -> bool:
    """Store and acknowledge A-lines as they come; True when the plan is done, False when the lease has lapsed."""
    try:
        for batch in scanner.alines():
            store.append(batch)
            store.set_fired(max(0, scanner.status.shots - before))
            scanner.acknowledge(batch[-1])
            if progress:
                progress("A-lines", store.stored, store.count)
            if cancelled and cancelled():
                scanner.abort("laser-off")
                raise Cancelled(f"the scan was stopped after {store.stored} of {store.count} A-lines; they are kept")
    except fabry_perot.LeaseLapsed:
        return False
    return True
