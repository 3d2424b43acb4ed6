"""``/session``: exchange an API key for an HttpOnly session cookie."""

from __future__ import annotations

from datetime import datetime

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool

from steradian.api.http.session_cookie import TOKEN, delete_session_cookie, session_secret, set_cookie
from steradian.api.http.urls import link
from steradian.api.middleware.authentication import LOOPBACK, V1, AuthorizedRoute
from steradian.api.middleware.stop_authorization import STOP_TICKET
from steradian.api.params.dependencies import CurrentPrincipal, ServicesDep
from steradian.security.keys import Principal, Scope
from steradian.security.sessions import ValidSession
from steradian.security.stop_tickets import StopTickets

router = APIRouter(prefix=V1, tags=["service"], route_class=AuthorizedRoute)


class SessionView(BaseModel):
    """Session: the caller and their scopes."""

    principal: str = Field(description="As which the caller is known", examples=["key bench (0123456789ab)", "local"])
    scopes: list[Scope] = Field(description="Scopes of the caller; admin includes all")
    csrf_token: str | None = Field(
        description=f"Value of the header {TOKEN} of requests with the session's cookie that change something;"
        " null where there is no session"
    )
    expires: datetime | None = Field(description="When the session ends; null where there is none")

    stop_ticket: str | None = Field(
        description=f"Value of the header {STOP_TICKET}, with which the emergency stop can be pressed for 7 days, also"
        " after the session has ended or the key was revoked; null where no key is needed"
    )

    @classmethod
    def of(cls, principal: Principal, seen: ValidSession | None, tickets: StopTickets) -> SessionView:
        """Return the view of a principal and session, with a new stop ticket."""
        return cls(
            principal=principal.name,
            scopes=sorted(principal.scopes),
            csrf_token=None if seen is None else seen.csrf_token,
            expires=None if seen is None else seen.expires,
            stop_ticket=None if principal == LOOPBACK else tickets.issue(principal),
        )


@router.post("/session", status_code=201, summary="Sign in with a key: a cookie instead of it")
async def create_session(
    services: ServicesDep, request: Request, response: Response, who: CurrentPrincipal
) -> SessionView:
    """Create a session for the key in Authorization; its HttpOnly cookie authenticates as the key does.

    It lasts for 12 hours and ends with its key. What changes something must bring the header X-CSRF-Token besides.
    """
    principal = Principal(who.name, who.scopes) if hasattr(request.state, "session") else who
    secret = await run_in_threadpool(services.sessions.open, principal)
    set_cookie(response, secret, request)
    response.headers["Location"] = link("/session")
    return SessionView.of(who, await run_in_threadpool(services.sessions.check, secret), services.stop_tickets)


@router.get("/session", summary="The caller and its session")
async def read_session(services: ServicesDep, request: Request, who: CurrentPrincipal) -> SessionView:
    """Return the principal of the key or cookie; without keys every caller of this machine is ``local``."""
    return SessionView.of(who, getattr(request.state, "session", None), services.stop_tickets)


@router.delete("/session", status_code=204, summary="Sign out")
async def delete_session(services: ServicesDep, request: Request, response: Response) -> None:
    """End the session of the cookie, if there is one; its key stays valid."""
    if secret := session_secret(request.headers):
        await run_in_threadpool(services.sessions.revoke, secret)
    delete_session_cookie(response, request)
