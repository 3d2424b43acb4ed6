"""Submission of scans: choice of the scanner, lease, disk space and row, in one idempotent transaction."""

from __future__ import annotations

from sqlalchemy.orm import Session

from steradian.api.schemas.resources import ScanView
from steradian.api.schemas.scans import ScanRequest
from steradian.api.services import ServiceContainer
from steradian.core.exceptions import Conflict, InvalidInput
from steradian.security.keys import Principal
from steradian.storage.capacity.reserve import scan_bytes
from steradian.storage.db.tables import PlanRow, ScannerRow, ScanRow
from steradian.storage.repositories.idempotency import IdempotencyKey, StoredResponse
from steradian.storage.repositories.scan_stages import has_further_stages
from steradian.storage.repositories.scanner_lease_and_stop import EmergencyStopped
from steradian.storage.state_machines import is_terminal


def submit_scan(
    services: ServiceContainer, principal: Principal, request: ScanRequest, key: IdempotencyKey, lease: int | None
) -> StoredResponse:
    """Queue a scan and return the response for this and for repeated requests.

    Raises
    ------
    NotFound, Conflict, InvalidInput
        When the plan, the scanner or the scan to be completed is missing or unsuitable.
    EmergencyStopped, LeaseHeld
        When the caller may not start the laser.
    DiskFull
        When the scan file does not fit on the disk.
    """
    if (stored := services.idempotency.get(key)) is not None:
        return stored
    plan = services.plans.get(request.plan_id)
    scanner_id = request.scanner_id
    if request.completes is not None:
        scanner_id = _scanner_for_continuation(
            services, _require_completable(services, request.completes, plan), scanner_id
        )
    scanner = _scanner_for(services, scanner_id)
    services.require_disk_space(scan_bytes(plan), "the scan", for_scan=True)

    def run(session: Session) -> StoredResponse:
        fence = require_lease(services, session, lease, principal, scanner.id)
        row = services.scans.add(
            session,
            plan,
            simulated=scanner.simulated,
            completes=request.completes,
            labels=request.labels,
            fence=fence,
            who=principal.name,
            scanner_id=scanner.id,
        )
        session.flush()
        view = ScanView.of(row)
        return StoredResponse(201, view.links["self"], view.model_dump_json())

    return services.idempotency.run_once(key, run)


def _require_completable(services: ServiceContainer, scan_id: str, plan: PlanRow) -> ScanRow:
    """Return the scan to be completed; reject a scan that a new scan of the plan cannot complete."""
    row = services.scans.get(scan_id)
    if row.plan_id != plan.id:
        raise InvalidInput("plan_id", plan.id, f"{row.plan_id}, the plan of the scan that is to be completed")
    if not is_terminal(row.state):
        raise Conflict(f"scan {scan_id} is {row.state}: it may still continue, and can be completed when it has ended")
    held = row.summary or {}
    if not held.get("stored"):
        raise Conflict(f"scan {scan_id} holds no A-line to begin with; scan its plan")
    if held["stored"] == held.get("points") and not has_further_stages(row):
        raise Conflict(f"scan {scan_id} misses nothing")
    return row


def _scanner_for_continuation(services: ServiceContainer, earlier: ScanRow, requested: str | None) -> str | None:
    """Return the scanner that completes a scan: its own, because another one could not pass the resume checks."""
    own = earlier.scanner_id
    if own is None or all(row.id != own for row in services.scanner.rows()):
        return requested  # it may have another name by now
    if requested not in {None, own}:
        raise InvalidInput("scanner_id", requested, f"{own}, which measured the scan that is to be completed")
    return own


def _scanner_for(services: ServiceContainer, requested: str | None) -> ScannerRow:
    """Return the scanner that will run a scan: the requested one, or the only one."""
    if requested is not None or services.settings.role == "service":
        return services.scanner.get(requested or services.scanner.id)
    rows = services.scanner.rows()
    if len(rows) > 1:
        raise InvalidInput("scanner_id", requested, f"one of {', '.join(row.id for row in rows)}")
    return rows[0] if rows else services.scanner.get(services.scanner.id)


def require_lease(
    services: ServiceContainer, session: Session, lease: int | None, principal: Principal, scanner_id: str
) -> int:
    """Return the lease number (fencing token) with which a caller may start the laser; raises if not permitted."""
    stop = services.local_stop_controller(scanner_id)
    if stop is not None and stop.active is not None:
        raise EmergencyStopped("the emergency stop is pressed; release it first")
    return services.scanner.of(scanner_id).check_fence(session, lease, principal.name)
