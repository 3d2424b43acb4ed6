"""Whether a request came straight from a program of this machine, or through a proxy on it."""

from __future__ import annotations

import os
from typing import Final

from starlette.datastructures import Headers
from starlette.types import Scope

from steradian.api.http.loopback_user import GONE, Peer

HEADERS: Final = frozenset(
    {"forwarded", "via", "x-real-ip", "x-client-ip", "x-cluster-client-ip", "true-client-ip", "x-scheme"}
    | {"x-request-start", "x-proxyuser-ip", "x-remote-ip", "x-amzn-trace-id", "cdn-loop", "proxy-connection"}
)
"""Headers that proxies add, beside those that begin as :data:`FAMILIES` do."""
FAMILIES: Final = ("x-forwarded", "x-original-", "x-envoy-", "x-arr-", "cf-", "fly-", "x-appengine-")


def is_forwarded(scope: Scope) -> bool:
    """Whether a proxy says that it passed this on, or one must have: browsers and our clients speak HTTP/1.1.

    HTTP/1.0 is what nginx, Apache's older modules and small proxies speak to a service by default, and nothing else
    does that a person uses.
    """
    if scope.get("http_version", "1.1") not in {"1.1", "2"}:
        return True
    return any(name in HEADERS or name.startswith(FAMILIES) for name in Headers(scope=scope))


def stranger(scope: Scope) -> str | None:
    """Return the reason why a request may not come from the service's own user; ``None`` without one.

    The system is asked whose process is at the other end of the connection, which no request can change: the proxy's,
    say, or another user's of this machine. The administrator may do all anyway.
    """
    peer: Peer | None = scope.get("state", {}).get("peer")
    user = None if peer is None else peer.user
    if user is None or user in {0, os.getuid()}:
        return None
    if user == GONE:
        return "the client process has ended"
    return f"the client process runs as another user (number {user}), as a proxy does"
