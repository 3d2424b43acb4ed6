"""Security headers added to every response (CSP, nosniff, no-store, frame denial)."""

from __future__ import annotations

from typing import Final

from starlette.types import Message

POLICY: Final = "default-src 'none'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
"""Content-Security-Policy of what is no page: nothing it could hold is run or loaded."""
SECURITY_HEADERS: Final = {
    "X-Content-Type-Options": "nosniff",
    "Content-Security-Policy": POLICY,
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}
CACHEABLE, NO_STORE = "private, no-cache", "no-store"
"""Cache-Control of what has an ETag, which a cache may keep for its user but must ask about, and of anything else."""
_RAW: Final = [(name.lower().encode(), value.encode()) for name, value in SECURITY_HEADERS.items()]


def add_security_headers(start: Message) -> None:
    """Add the security headers that are missing to the start message of a response."""
    raw: list[tuple[bytes, bytes]] = start["headers"]
    there = {name for name, _ in raw}
    raw.extend(pair for pair in _RAW if pair[0] not in there)
    if b"cache-control" not in there:
        kept = start["status"] < 400 and b"etag" in there
        raw.append((b"cache-control", (CACHEABLE if kept else NO_STORE).encode()))
