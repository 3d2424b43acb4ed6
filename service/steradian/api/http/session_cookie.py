"""Session cookie attributes and cross-site request forgery checks.

A browser adds the cookie to whatever any page has it ask, also a form of another site or a service at another port of
the same host. So such a request must come from a page of this origin, by what the browser says of it (``Origin``,
``Sec-Fetch-Site``: scripts cannot set either), and bring a token that other origins cannot read.
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
    """A cookie-authenticated request failed the origin or CSRF-token check."""

    code = "cross-site"


def session_secret(headers: Headers) -> str | None:
    """Return the session secret from the Cookie header, if present."""
    return cookie_parser("; ".join(headers.getlist("cookie"))).get(NAME) or None


def set_cookie(response: Response, secret: str, request: Request) -> None:
    """Give a browser the cookie: for this site only, for no script, and for no plain link where there is TLS."""
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
        Whether the request changes something: then it must bring the token and say that it comes from here.

    Raises
    ------
    CrossSiteRequest
        With what is missing.
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
    """Return the names by which this service was addressed, by a proxy's word too: no page can set its header."""
    return {host for host in (*headers.getlist("host"), *headers.getlist("x-forwarded-host")) if host}


def _is_secure(request: Request) -> bool:
    return request.url.scheme == "https" or request.headers.get("x-forwarded-proto", "").strip().lower() == "https"


def _path(request: Request) -> str | None:
    """Below which path the cookie is sent; ``None`` leaves it to the browser, which takes that of the session.

    So a browser can sign in below a path of which a proxy says nothing.
    """
    return None if is_forwarded(request.scope) and not prefix() else address(BASE)
