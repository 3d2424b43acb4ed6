"""``/scans``: running plans on the scanner."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

from fastapi import APIRouter, Request, Response
from pydantic import ConfigDict, Field, StringConstraints
from sqlalchemy.orm import Session
from starlette.concurrency import run_in_threadpool

from steradian.api.http.conditional import ReadPreconditionsDep, WritePreconditionsDep, resource_etag
from steradian.api.middleware.authentication import V1, AuthorizedRoute
from steradian.api.params.dependencies import (
    CurrentPrincipal,
    Limit,
    PageCursor,
    RequiredIdempotencyKey,
    ServicesDep,
    Wait,
    deleted_since,
    idempotent_response,
    set_next_link,
)
from steradian.api.params.filters import Labels, MaskIdFilter, PlanIdFilter, ScanStates, parse_labels
from steradian.api.params.path import SCAN_ID
from steradian.api.routers.scanners import Lease
from steradian.api.schemas.resources import Listing, ScanView
from steradian.api.services import ServiceContainer
from steradian.core.exceptions import Conflict, InvalidInput
from steradian.core.validation import Value
from steradian.security.keys import Principal
from steradian.storage.capacity.quota import scan_bytes
from steradian.storage.db.tables import PlanRow, ScannerRow, ScanRow
from steradian.storage.repositories import filters
from steradian.storage.repositories.idempotency import StoredResponse
from steradian.storage.repositories.scanners import EmergencyStopped
from steradian.storage.states import SETTLED_SCAN_STATES, DesiredScanState, is_terminal

router = APIRouter(prefix=f"{V1}/scans", tags=["scans"], route_class=AuthorizedRoute)

Name = Annotated[str, StringConstraints(min_length=1, max_length=60)]
Text = Annotated[str, StringConstraints(max_length=200)]


class ScanRequest(Value):
    """Request to run a plan."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"plan_id": "p0123456789abcdef01234567", "labels": {"phantom": "yarn"}}]}
    )

    plan_id: str = Field(min_length=1, max_length=64, description="Identifier of the plan")
    scanner_id: str | None = Field(
        default=None, min_length=1, max_length=40, description="Scanner that runs it; optional if there is one scanner"
    )
    labels: dict[Name, Text] = Field(default_factory=dict, max_length=50, description="Texts of your own")
    completes: str | None = Field(
        default=None,
        min_length=1,
        max_length=64,
        description="A scan of the same plan that is over: the new one begins with its A-lines and measures what is"
        " missing, if film and scanner prove to be as they were; the earlier one stays as it is",
    )


class ScanChange(Value):
    """Change of a scan's labels."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"labels": {"phantom": "yarn", "draft": None}}]})

    labels: dict[Name, Text | None] = Field(max_length=50, description="Labels to set; null takes one away")


class ScanWish(Value):
    """Desired state of a scan, as requested."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"state": "stopped", "reason": "enough"}]})

    state: DesiredScanState = Field(
        description="running: go on after a pause or an interruption; paused: the laser rests; stopped keeps what was"
        " measured and is a success; aborted gives up. The last two cannot be taken back"
    )
    reason: str | None = Field(default=None, max_length=500)


@router.post(
    "",
    status_code=201,
    summary="Queue a run of a plan",
    response_model=ScanView,
    responses={201: {"headers": {"Location": {"schema": {"type": "string"}}}}},
)
async def create_scan(
    services: ServicesDep,
    who: CurrentPrincipal,
    wanted: ScanRequest,
    key: RequiredIdempotencyKey,
    wait: Wait,
    lease: Lease = None,
) -> Response:
    """Queue a scan. A request repeated with the same Idempotency-Key never fires twice: it gets the first answer."""

    def make(session: Session) -> StoredResponse:
        fence = _require_lease(services, session, lease, who, scanner.id)
        services.require_disk_space(session, scan_bytes(plan), "the scan", measured, for_scan=True)
        about: dict[str, Any] = {"labels": wanted.labels, "fence": fence, "who": who.name, "scanner_id": scanner.id}
        row = services.scans.add(session, plan, simulated=scanner.simulated, completes=wanted.completes, **about)
        session.flush()
        view = ScanView.of(row)
        return StoredResponse(201, view.links["self"], view.model_dump_json())

    answer = await run_in_threadpool(services.answers.get, key)
    if answer is None:
        plan = await run_in_threadpool(services.plans.get, wanted.plan_id)
        scanner_id = wanted.scanner_id
        if wanted.completes is not None:
            earlier = await run_in_threadpool(_require_completable, services, wanted.completes, plan)
            scanner_id = await run_in_threadpool(_scanner_for_continuation, services, earlier, scanner_id)
        scanner = await run_in_threadpool(_scanner_for, services, scanner_id)
        measured = await run_in_threadpool(services.refresh_disk_usage)
        answer = await run_in_threadpool(services.answers.run_once, key, make)
    if not wait.seconds:
        return idempotent_response(answer)
    identifier = answer.location.rpartition("/")[2]
    with deleted_since(answer):
        view = ScanView.of(await wait.wait_for(lambda: services.scans.get(identifier), is_settled))
        answer = replace(answer, location=view.links["self"], body=view.model_dump_json())
    return idempotent_response(answer)


@router.get("", summary="Scans, newest first")
def list_scans(
    services: ServicesDep,
    request: Request,
    response: Response,
    state: ScanStates = None,
    label: Labels = None,
    plan_id: PlanIdFilter = None,
    mask_id: MaskIdFilter = None,
    limit: Limit = 100,
    before: PageCursor = None,
) -> Listing[ScanView]:
    """List scans."""
    where = filters.scans(state=state, label=parse_labels(label), plan_id=plan_id, mask_id=mask_id)
    page = services.scans.page(limit, before, where)
    set_next_link(response, request, limit, page.cursor)
    return Listing(items=[ScanView.of(row) for row in page.rows])


@router.get("/{scan_id}", summary="One scan")
async def read_scan(services: ServicesDep, scan_id: SCAN_ID, wait: Wait, conditions: ReadPreconditionsDep) -> ScanView:
    """Show a scan."""
    row = await wait.wait_for(lambda: services.scans.get(scan_id), is_settled)
    view = ScanView.of(row)
    conditions.tag(resource_etag(row.id, row.revision, view))
    return view


@router.patch("/{scan_id}", summary="Label a scan")
def change_scan(
    services: ServicesDep, scan_id: SCAN_ID, wanted: ScanChange, conditions: WritePreconditionsDep
) -> ScanView:
    """Set or take away labels; with If-Match only if the scan has not changed since."""
    row = services.scans.label(scan_id, wanted.labels, conditions.revision(scan_id))
    view = ScanView.of(row)
    conditions.tag(resource_etag(row.id, row.revision, view))
    return view


@router.put("/{scan_id}/desired-state", summary="Run, pause, stop or abort a scan")
def set_scan_desired_state(
    services: ServicesDep,
    who: CurrentPrincipal,
    scan_id: SCAN_ID,
    wanted: ScanWish,
    conditions: WritePreconditionsDep,
    lease: Lease = None,
) -> ScanView:
    """Set the desired state of a scan; repeating it has no effect.

    ``running`` requires the scanner's lease, if one is held.

    An interrupted scan goes on only by this: it proves that plan, scanner and tuning are what they were, or stays
    interrupted with the difference as its error.
    """
    revision = conditions.revision(scan_id)
    row = services.scans.set_desired_state(
        scan_id,
        wanted.state,
        wanted.reason,
        who.name,
        revision,
        admit=lambda session, row: _require_lease(services, session, lease, who, row.scanner_id or services.scanner.id),
    )
    view = ScanView.of(row)
    conditions.tag(resource_etag(row.id, row.revision, view))
    return view


def _require_completable(services: ServiceContainer, scan_id: str, plan: PlanRow) -> ScanRow:
    """Refuse a scan that cannot be completed by another one of a plan."""
    row = services.scans.get(scan_id)
    if row.plan_id != plan.id:
        raise InvalidInput("plan_id", plan.id, f"{row.plan_id}, the plan of the scan that is to be completed")
    if not is_terminal(row.state):
        raise Conflict(f"scan {scan_id} is {row.state}: it may still continue, and can be completed when it has ended")
    held = row.summary or {}
    if not held.get("stored"):
        raise Conflict(f"scan {scan_id} holds no A-line to begin with; scan its plan")
    if held["stored"] == held.get("points"):
        raise Conflict(f"scan {scan_id} misses nothing")
    return row


def _scanner_for_continuation(services: ServiceContainer, earlier: ScanRow, wanted: str | None) -> str | None:
    """Return the scanner that completes a scan: its own, because another one could not pass the resume checks."""
    own = earlier.scanner_id
    if own is None or all(row.id != own for row in services.scanner.rows()):
        return wanted  # it may have another name by now
    if wanted not in {None, own}:
        raise InvalidInput("scanner_id", wanted, f"{own}, which measured the scan that is to be completed")
    return own


def is_settled(row: ScanRow) -> bool:
    """Whether a scan changes only when a person asks."""
    return row.state in SETTLED_SCAN_STATES


def _scanner_for(services: ServiceContainer, wanted: str | None) -> ScannerRow:
    """Return the scanner that will run a scan: the requested one, or the only one."""
    if wanted is not None or services.settings.role == "service":
        return services.scanner.get(wanted or services.scanner.id)
    rows = services.scanner.rows()
    if len(rows) > 1:
        raise InvalidInput("scanner_id", wanted, f"one of {', '.join(row.id for row in rows)}")
    return rows[0] if rows else services.scanner.get(services.scanner.id)


def _require_lease(
    services: ServiceContainer, session: Session, lease: int | None, who: Principal, scanner_id: str
) -> int:
    """Return the lease number with which a caller may start the laser; see :meth:`ScannerRepository.check_fence`."""
    desk = services.local_stop_controller(scanner_id)
    if desk is not None and desk.active is not None:
        raise EmergencyStopped("the emergency stop is pressed; release it first")
    return services.scanner.of(scanner_id).check_fence(session, lease, who.name)
