"""Authorisation of emergency stops, without the database where possible."""

from __future__ import annotations

import re
from contextlib import suppress
from typing import Final

from starlette.datastructures import Headers
from starlette.types import Scope

from steradian.api.http.session_cookie import check_same_origin, session_secret
from steradian.security.keys import Forbidden, KeyStore, Principal, Unauthorized
from steradian.security.sessions import SessionStore
from steradian.security.stop_tickets import StopTickets

_V1: Final = "/api/v1"
STOP_TICKET: Final = "X-Stop-Ticket"
"""Header with which a page presses the stop after its session has ended; see :mod:`steradian.security.stop_tickets`."""
EMERGENCY_STOP: Final = re.compile(rf"{_V1}/(?:scanners/[^/]+/)?emergency-stop")
"""The paths of the stop, which are answered while the database is not: keys are known from the last look at it."""


def is_stop(scope: Scope) -> bool:
    """Return whether a request presses an emergency stop or checks the caller's permission for one."""
    method, path = scope["method"], scope["path"]
    if method in {"GET", "HEAD"}:
        return bool(path == f"{_V1}/emergency-stop")
    return bool(method == "POST" and EMERGENCY_STOP.fullmatch(path))


def bearer_of_ticket(scope: Scope, keys: KeyStore, sessions: SessionStore, tickets: StopTickets) -> Principal | None:
    """Return the principal of a stop ticket; ``None`` if the request needs the usual credentials.

    A key or session that was valid at the last refresh from the database takes precedence, because the press is then
    recorded without mention of the ticket. A ticket is checked without the database, which may not answer.
    """
    headers = Headers(scope=scope)
    ticket = headers.get(STOP_TICKET)
    if ticket is None or not is_stop(scope):
        return None
    if (known := _remembered(headers, keys, sessions, changes=scope["method"] == "POST")) is not None:
        return known
    with suppress(Unauthorized):
        return tickets.check(ticket)
    return None


def _remembered(headers: Headers, keys: KeyStore, sessions: SessionStore, *, changes: bool) -> Principal | None:
    with suppress(Unauthorized, Forbidden):
        if given := headers.get("authorization", ""):
            return keys.check_cached(given.partition(" ")[2].strip())
        if secret := session_secret(headers):
            seen = sessions.check_cached(secret)
            check_same_origin(seen, headers, changes=changes)
            return seen.principal
    return None
