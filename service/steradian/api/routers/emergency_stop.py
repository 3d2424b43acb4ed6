"""``/emergency-stop``: press the emergency stop of all scanners, or check the permission for that."""

from __future__ import annotations

import asyncio
from typing import Annotated

from fastapi import APIRouter, Body, Request
from pydantic import BaseModel, Field

from steradian.api.middleware.authentication import V1, AuthorizedRoute
from steradian.api.params.dependencies import CurrentPrincipal, ServicesDep
from steradian.api.routers.scanners import StopRequest, press_stop
from steradian.api.schemas.resources import Listing
from steradian.api.schemas.scanners import EmergencyAnswer

router = APIRouter(prefix=V1, tags=["scanners"], route_class=AuthorizedRoute)


class StopRight(BaseModel):
    """Permission of the caller to press the emergency stop."""

    by: str = Field(description="The name under which a press would be recorded", examples=["key bench (0123456789ab)"])


@router.get("/emergency-stop", summary="Whether you may press the emergency stop")
async def read_emergency_stops(who: CurrentPrincipal) -> StopRight:
    """Return the name under which an emergency stop by this caller would be recorded, without pressing one.

    Authorized exactly as a press is: by a key, a session or a stop ticket, without the database. Pages poll this, so
    that they offer the stop only while a press would be accepted.
    """
    return StopRight(by=who.name)


@router.post("/emergency-stop", status_code=202, summary="Stop every scanner now")
async def press_emergency_stops(
    services: ServicesDep, request: Request, who: CurrentPrincipal, wanted: Annotated[StopRequest | None, Body()] = None
) -> Listing[EmergencyAnswer]:
    """Press the emergency stop of all scanners; any authenticated caller may, without knowing their names.

    This needs no database. The response lists each scanner; an empty list means that the service knows none: then use
    the laser's hardware switch.
    """
    reason = wanted.reason if wanted else None
    presses = (press_stop(services, request, who, name, reason) for name in services.nodes.scanners)
    return Listing(items=await asyncio.gather(*presses))
