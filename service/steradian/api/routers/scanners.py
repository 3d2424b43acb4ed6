"""``/scanners``: state, lease and emergency stop of scanners."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Body, Header, Query, Request, Response
from pydantic import ConfigDict, Field

from steradian.api.background.peers import STOP_ID_HEADER, ForwardToPeer, is_forwarded
from steradian.api.http.conditional import ReadPreconditionsDep, resource_etag
from steradian.api.http.urls import link
from steradian.api.middleware.authentication import V1, AuthorizedRoute
from steradian.api.params.dependencies import CurrentPrincipal, ServicesDep
from steradian.api.params.path import SCANNER_ID
from steradian.api.schemas.resources import Listing
from steradian.api.schemas.scanners import EmergencyAnswer, EmergencyView, ScannerView
from steradian.api.services import ServiceContainer
from steradian.api.use_cases.decommission import decommission_scanner
from steradian.core.exceptions import NotFound
from steradian.core.validation import Value
from steradian.security.keys import Principal, Scope
from steradian.storage.db.tables import ScannerRow

router = APIRouter(prefix=f"{V1}/scanners", tags=["scanners"], route_class=AuthorizedRoute)

FIRES = "the scanner reports its laser on or armed after the stop"
Number = Annotated[int, Header(alias="Scanner-Lease", ge=0, le=2**31, description="Number (fence) of your lease")]
Lease = Annotated[
    int | None,
    Header(alias="Scanner-Lease", ge=0, le=2**31, description="Number (fence) of your lease, if you hold one"),
]


class LeaseRequest(Value):
    """Request for a lease: holder and duration."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"holder": "Ada", "seconds": 600, "note": "phantoms"}]})

    holder: str = Field(
        min_length=1,
        max_length=120,
        description="Name of the operator or program; the lease is the key's",
    )
    seconds: float = Field(default=600.0, ge=1, le=86_400, description="How long from now (s)")
    note: str | None = Field(default=None, max_length=500)


class ClearRequest(Value):
    """Request to clear a scanner's latched fault, with the reason."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"reason": "the enclosure is closed again"}]})

    reason: str | None = Field(default=None, max_length=500)


class StopRequest(Value):
    """Request to press the emergency stop, with the reason."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"reason": "smoke"}]})

    reason: str | None = Field(default=None, max_length=500)


@router.get("", summary="All scanners")
def list_scanners(services: ServicesDep) -> Listing[ScannerView]:
    """List the scanners."""
    return Listing(
        items=[_view(services, row) for row in sorted(services.scanner.rows(), key=_field_path, reverse=True)]
    )


@router.get("/{scanner_id}", summary="One scanner")
def read_scanner(services: ServicesDep, scanner_id: SCANNER_ID, conditions: ReadPreconditionsDep) -> ScannerView:
    """Return a scanner: its connection, activity, reported state and lease.

    What it says of laser, shutter, interlock, key and fault is as old as `age` says, and `unknown` when that is more
    than a second (ten for the scanner of another node): unknown is not off.
    """
    row = services.scanner.get(scanner_id)
    view = _view(services, row)
    conditions.tag(resource_etag(row.id, row.revision, view.model_copy(update={"age": None, "looked_at": None})))
    return view


@router.delete("/{scanner_id}", status_code=204, summary="Retire a scanner that no longer exists")
def retire_scanner(
    services: ServicesDep,
    request: Request,
    who: CurrentPrincipal,
    scanner_id: SCANNER_ID,
    abandon: Annotated[
        bool, Query(description="Also end its unfinished scans: their stored A-lines are kept as partial scans")
    ] = False,
    reason: Annotated[str | None, Query(max_length=500, description="Why; in its event")] = None,
) -> Response:
    """Decommission a scanner: it no longer receives stops, requests or scans.

    It is refused while its node lives, as far as that can be told; where that lost database and network, only a
    person can see that its laser is off. Should it start again, the scanner is there again, and its stop as it was.
    """
    decommission_scanner(services, request, who, scanner_id, reason, abandon=abandon)
    return Response(status_code=204)


@router.put("/{scanner_id}/lease", summary="Take a scanner, or hold it for longer")
def take_scanner_lease(
    services: ServicesDep, who: CurrentPrincipal, scanner_id: SCANNER_ID, wanted: LeaseRequest, lease: Lease = None
) -> ScannerView:
    """Take the lease of a scanner until it expires; its number (fencing token) increases with each new lease.

    The lease belongs to the key: only requests with the same key and the lease's number make the laser fire. Two
    clients of one key, and all of a service without keys, are told apart by ``holder`` or that number.
    """
    (scanner := services.scanner.of(scanner_id)).get(scanner_id)
    return _view(services, scanner.lease(wanted.holder, wanted.seconds, wanted.note, who.name, lease))


@router.delete("/{scanner_id}/lease", status_code=204, summary="Give a scanner back")
def return_scanner_lease(
    services: ServicesDep, who: CurrentPrincipal, scanner_id: SCANNER_ID, lease: Number
) -> Response:
    """Release the lease of a scanner; without a lease nothing happens. An admin may release another's lease."""
    (scanner := services.scanner.of(scanner_id)).get(scanner_id)
    scanner.release(lease, who.name, whoever=who.may(Scope.ADMIN))
    return Response(status_code=204)


@router.post("/{scanner_id}/emergency-stop", status_code=202, summary="Stop the scanner now")
async def press_emergency_stop(
    services: ServicesDep,
    request: Request,
    who: CurrentPrincipal,
    scanner_id: SCANNER_ID,
    wanted: Annotated[StopRequest | None, Body()] = None,
) -> EmergencyAnswer:
    """Switch the laser off and abort running and queued scans.

    Any authenticated caller may do so, with or without a lease.

    It needs no database: what cannot be recorded now is recorded later. The answer comes when the scanner has
    confirmed it, whoever holds its port, or after two seconds with the reason why it could not be asked. No other scan
    begins until the stop is released, whatever is started anew.
    """
    if not services.nodes.contains(scanner_id):
        raise NotFound("scanner", scanner_id)
    return await press_stop(services, request, who, scanner_id, wanted.reason if wanted else None)


async def press_stop(
    services: ServiceContainer, request: Request, who: Principal, scanner_id: str, reason: str | None
) -> EmergencyAnswer:
    """Press the emergency stop of one scanner, locally or through the relay."""
    if (desk := services.local_stop_controller(scanner_id)) is None:
        services.nodes.reject_forwarding_loop(request, scanner_id)
        return await services.stop_relay.press(scanner_id, who, reason)
    errand = request.headers.get(STOP_ID_HEADER) if is_forwarded(request) else None
    press, deed = await desk.press(who.name, reason, errand)
    shown = EmergencyView.of(press, deed, recorded=desk.is_recorded(press))
    here = link(f"/scanners/{scanner_id}")
    return EmergencyAnswer(id=scanner_id, emergency_stop=shown, links={"scanner": here})


@router.delete("/{scanner_id}/emergency-stop", summary="Release the emergency stop")
def release_emergency_stop(
    services: ServicesDep,
    request: Request,
    who: CurrentPrincipal,
    scanner_id: SCANNER_ID,
    number: Annotated[
        str | None, Query(max_length=40, description="Release this press only; refused when there was another since")
    ] = None,
    reason: Annotated[str | None, Query(max_length=500, description="Why it may be released; in its event")] = None,
) -> ScannerView:
    """Release the emergency stop of a scanner; no scan starts by itself."""
    services.scanner.get(scanner_id)
    if (desk := services.local_stop_controller(scanner_id)) is not None:
        desk.release(who.name, number, reason)
    elif services.is_single_node and not is_forwarded(request):
        # No node has its latch; one that comes back keeps its own.
        services.scanner.of(scanner_id).release_stop(who.name, reason, number)
    else:
        raise ForwardToPeer(scanner_id)
    return _view(services, services.scanner.get(scanner_id))


@router.post("/{scanner_id}/clear-fault", summary="Clear a latched fault")
def clear_fault(
    services: ServicesDep,
    who: CurrentPrincipal,
    scanner_id: SCANNER_ID,
    wanted: Annotated[ClearRequest | None, Body()] = None,
) -> ScannerView:
    """Clear the fault that the scanner has latched; the laser stays off, and an interrupted scan can be resumed.

    Refused (409 `fault-stands`) while the cause stands: the interlock is open, the key is off, the shutter is open.
    Nothing happens where no fault is latched. The event that records it names the caller.
    """
    services.scanner.get(scanner_id)
    if services.faults is None or not services.nodes.is_local(scanner_id):
        raise ForwardToPeer(scanner_id)
    services.faults.clear(who.name, wanted.reason if wanted else None)
    return _view(services, services.scanner.get(scanner_id))


def _field_path(row: ScannerRow) -> int:
    return row.sequence


def _view(services: ServiceContainer, row: ScannerRow) -> ScannerView:
    stop, desk = EmergencyView.of_row(row), services.local_stop_controller(row.id)
    if desk is not None:  # the latch may be ahead of the database
        press = desk.active
        stop = EmergencyView.of(press, desk.outcome(press), recorded=desk.is_recorded(press)) if press else None
    status = services.status.read() if services.status is not None and services.nodes.is_local(row.id) else None
    if stop is not None and status is not None and status.laser in {"armed", "on"} and stop.laser != "unconfirmed":
        # another program fires again while the stop stands; it is being stopped
        stop = stop.model_copy(update={"laser": "unconfirmed", "detail": f"{FIRES}: use the hardware switch"})
    return ScannerView.of(row, status, services.clock(), held=services.scanner.is_held(row), stop=stop)
