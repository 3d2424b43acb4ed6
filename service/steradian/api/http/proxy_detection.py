"""Detection of requests that came through a proxy or from another user's process on this machine."""

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
    """Return whether a request came through a proxy, according to its headers or its HTTP version (1.0).

    nginx, older Apache modules and small proxies use HTTP/1.0 by default; browsers and our clients use HTTP/1.1.
    """
    if scope.get("http_version", "1.1") not in {"1.1", "2"}:
        return True
    return any(name in HEADERS or name.startswith(FAMILIES) for name in Headers(scope=scope))


def stranger(scope: Scope) -> str | None:
    """Return the reason why the client process is not known to run as the service's user; ``None`` without one.

    The kernel reports the user of the client process, which a request cannot forge. Another user's process may be a
    proxy. Processes of root are accepted.
    """
    peer: Peer | None = scope.get("state", {}).get("peer")
    user = None if peer is None else peer.user
    if user is None or user in {0, os.getuid()}:
        return None
    if user == GONE:
        return "the client process has ended"
    return f"the client process runs as another user (number {user}), as a proxy does"
