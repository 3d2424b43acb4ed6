"""``/scans``: scans, the runs of plans on a scanner."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Path, Request, Response
from pydantic import ConfigDict, Field
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
    final_response,
    set_next_link,
)
from steradian.api.params.filters import Labels, MaskIdFilter, PlanIdFilter, ScanStates, parse_labels
from steradian.api.params.path import SCAN_ID
from steradian.api.routers.scanners import Lease
from steradian.api.schemas.resources import Listing, ScanView
from steradian.api.schemas.scans import Name, ScanRequest, StageDecision, Text
from steradian.api.use_cases.scan_stages import decide_stage
from steradian.api.use_cases.scan_submission import require_lease, submit_scan
from steradian.core.validation import Value
from steradian.plans.stages import MOST_STAGES
from steradian.storage.db.tables import ScanRow
from steradian.storage.repositories import filters
from steradian.storage.state_machines import SETTLED_SCAN_STATES, DesiredScanState

StageNumber = Annotated[int, Path(ge=2, le=MOST_STAGES + 1, description="Number of the stage, from 2")]
router = APIRouter(prefix=f"{V1}/scans", tags=["scans"], route_class=AuthorizedRoute)


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

    def read(identifier: str) -> tuple[ScanView, bool]:
        row = services.scans.get(identifier)
        return ScanView.of(row), is_settled(row)

    answer = await run_in_threadpool(submit_scan, services, who, wanted, key, lease)
    return await final_response(answer, wait, read)


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
    """Return a scan: its state, progress and summary."""
    row = await wait.wait_for(lambda: services.scans.get(scan_id), is_settled)
    view = ScanView.of(row)
    conditions.tag(resource_etag(row.id, row.revision, view))
    return view


@router.patch("/{scan_id}", summary="Label a scan")
def change_scan(
    services: ServicesDep, scan_id: SCAN_ID, wanted: ScanChange, conditions: WritePreconditionsDep
) -> ScanView:
    """Set or remove labels of a scan; with If-Match only if the scan has not changed since."""
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
        admit=lambda session, row: require_lease(services, session, lease, who, row.scanner_id or services.scanner.id),
    )
    view = ScanView.of(row)
    conditions.tag(resource_etag(row.id, row.revision, view))
    return view


@router.put("/{scan_id}/stages/{number}", summary="Choose the points of interest of a stage")
def set_scan_stage(
    services: ServicesDep,
    who: CurrentPrincipal,
    scan_id: SCAN_ID,
    number: StageNumber,
    wanted: StageDecision,
    lease: Lease = None,
) -> ScanView:
    """Choose the points of interest of a stage that is not made yet; repeating it has no effect.

    It requires the scanner's lease, if one is held: the scan goes on with these points, within what the plan agreed to.
    A stage that is decided already is a conflict, unless the scan is interrupted.
    """
    return ScanView.of(decide_stage(services, who, scan_id, number, wanted, lease))


def is_settled(row: ScanRow) -> bool:
    """Return whether a scan changes only at a person's request: it has ended or is interrupted."""
    return row.state in SETTLED_SCAN_STATES
