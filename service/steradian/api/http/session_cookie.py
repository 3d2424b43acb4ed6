"""Session cookie attributes and cross-site request forgery checks.

A browser adds the cookie to every request to this host, also to those of another site's form or of a service on another
port. So such a request must come from a page of this origin according to ``Origin`` and ``Sec-Fetch-Site``, which
scripts cannot set, and must contain a token that other origins cannot read.
"""

from __future__ import annotations

import hmac
from typing import Final

from fastapi import Request, Response
from starlette.datastructures import Headers
from starlette.requests import cookie_parser

from steradian.api.http.proxy_detection import is_forwarded
from steradian.api.http.urls import BASE, address, prefix
from steradian.security.keys import Forbidden
from steradian.security.sessions import LIFETIME, ValidSession

NAME: Final = "steradian_session"
TOKEN: Final = "X-CSRF-Token"  # noqa: S105 - the header's name


class CrossSiteRequest(Forbidden):
    """Error: a cookie-authenticated request failed the origin or CSRF-token check."""

    code = "cross-site"


def session_secret(headers: Headers) -> str | None:
    """Return the session's secret from the Cookie header; ``None`` without one."""
    return cookie_parser("; ".join(headers.getlist("cookie"))).get(NAME) or None


def set_cookie(response: Response, secret: str, request: Request) -> None:
    """Set the session cookie in a response: HttpOnly, SameSite=strict, and Secure over TLS."""
    response.set_cookie(
        NAME,
        secret,
        max_age=int(LIFETIME.total_seconds()),
        path=_path(request),
        secure=_is_secure(request),
        httponly=True,
        samesite="strict",
    )


def delete_session_cookie(response: Response, request: Request) -> None:
    """Expire the session cookie in the browser."""
    where = _path(request)
    response.set_cookie(
        NAME, "", max_age=0, expires=0, path=where, secure=_is_secure(request), httponly=True, samesite="strict"
    )


def check_same_origin(seen: ValidSession, headers: Headers, *, changes: bool) -> None:
    """Reject cookie-authenticated requests from another origin or without a valid CSRF token.

    Parameters
    ----------
    changes
        Whether the request changes something: then the CSRF token and an origin header are required.

    Raises
    ------
    CrossSiteRequest
        With the check that failed.
    """
    origin, site = headers.get("origin"), headers.get("sec-fetch-site")
    followed = not changes and headers.get("sec-fetch-mode") == "navigate"
    if site not in {None, "same-origin"} and not followed and (changes or site != "none"):
        raise CrossSiteRequest(f"a request with a session's cookie must come from a page of this service, not {site}")
    if not changes:
        return
    if origin is not None and origin.partition("://")[2] not in _hosts(headers):
        raise CrossSiteRequest(f"a page of {origin!r} may not change anything with a session's cookie")
    if origin is None and site is None:
        raise CrossSiteRequest("a request with a session cookie must state its origin: Origin or Sec-Fetch-Site")
    if not hmac.compare_digest(headers.get(TOKEN, "").encode(), seen.csrf_token.encode()):
        raise CrossSiteRequest(
            f"a request with a session cookie must send {TOKEN} as GET {address(BASE)}/session tells it"
        )


def _hosts(headers: Headers) -> set[str]:
    """Return the host names of this service according to Host and X-Forwarded-Host, which no page can set."""
    return {host for host in (*headers.getlist("host"), *headers.getlist("x-forwarded-host")) if host}


def _is_secure(request: Request) -> bool:
    return request.url.scheme == "https" or request.headers.get("x-forwarded-proto", "").strip().lower() == "https"


def _path(request: Request) -> str | None:
    """Return the Path attribute of the session cookie; ``None`` leaves the path to the browser.

    So a browser can sign in through a proxy that serves the service below a path but does not send that path.
    """
    return None if is_forwarded(request.scope) and not prefix() else address(BASE)
