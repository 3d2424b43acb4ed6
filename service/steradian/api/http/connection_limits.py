"""uvicorn protocol with limits on open connections, header size and time to receive a request.

uvicorn ends a kept connection on which nothing more is asked. It waits for ever for the rest of a request that was
begun, takes any number of connections, and its faster parser takes headers of any length; this module adds the limits.
"""

from __future__ import annotations

import asyncio
import logging
from typing import Any

import uvicorn
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from steradian.api.http.loopback_user import Peer

HEAD_BYTES = 64 * 2**10
"""Largest request line with headers (bytes)."""
RESERVED_FILES = 128
"""File descriptors that are left for databases, files and pipes."""
_REFUSAL = b"HTTP/1.1 503 Service Unavailable\r\nContent-Length: 0\r\nRetry-After: 5\r\nConnection: close\r\n\r\n"
"""To a connection too many: no request of it has been read, so there is no identifier for a problem document."""
_log = logging.getLogger(__name__)


class ConnectionLimiter:
    """Connection limiter: when full, it closes the connection that has been idle longest.

    Parameters
    ----------
    most
        Maximum number of open connections.
    patience
        Seconds for which a client may send nothing of a request that it has begun.
    """

    def __init__(self, most: int, patience: float) -> None:
        self.most, self.patience = most, patience
        self.inside: set[LimitedHttpProtocol] = set()
        self.awaited: dict[LimitedHttpProtocol, None] = {}
        """Those whose client is to send something, the longest awaited first."""

    def admit(self, connection: LimitedHttpProtocol) -> bool:
        """Admit a connection, evicting the longest idle one when the limit is reached."""
        if len(self.inside) >= self.most:
            longest = next(iter(self.awaited), None)
            if longest is None:
                return False
            _log.warning("%d connections are open; the one that sends nothing for the longest time is ended", self.most)
            longest.drop()
        self.inside.add(connection)
        return True

    def release(self, connection: LimitedHttpProtocol) -> None:
        """Release a connection's slot."""
        self.inside.discard(connection)
        self.awaited.pop(connection, None)


class LimitedConfig(uvicorn.Config):
    """uvicorn Config that carries a ConnectionLimiter."""

    def __init__(self, app: Any, door: ConnectionLimiter, **options: Any) -> None:
        self.door = door
        # A connection that becomes a websocket, where a library for those is installed, would never leave the door.
        super().__init__(app, http=LimitedHttpProtocol, ws="none", **options)


class LimitedHttpProtocol(HttpToolsProtocol):
    """uvicorn's HTTP protocol with a receive timeout and a header size limit."""

    config: LimitedConfig

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._door = self.config.door
        self._head_bytes = 0
        self._in_head = True
        self._peer: Peer | None = None
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Admit the connection, or reject it with 503 when the limit is reached."""
        super().connection_made(transport)
        self._peer = Peer(self.client, self.server)
        if self._door.admit(self):
            self._await_client()
        else:
            transport.write(_REFUSAL)
            transport.close()

    def connection_lost(self, error: Exception | None) -> None:
        """Release the connection's slot in the limiter."""
        self._stop_awaiting()
        self._door.release(self)
        super().connection_lost(error)

    def data_received(self, data: bytes) -> None:
        """Pass received bytes to the parser, unless the request head is too long."""
        if self._in_head:
            self._head_bytes += len(data)
            if self._head_bytes > HEAD_BYTES + len(data) or (self._head_bytes > HEAD_BYTES and b"\r\n\r\n" not in data):
                self.send_400_response("The request's head is too long.")
                return
        super().data_received(data)

    def on_message_begin(self) -> None:
        """Start the timeout for the head of a request."""
        super().on_message_begin()
        self.scope["state"]["peer"] = self._peer
        self._in_head = True
        self._await_client()

    def on_headers_complete(self) -> None:
        """Start the timeout for the body of a request."""
        self._in_head, self._head_bytes = False, 0
        super().on_headers_complete()
        self._await_client()

    def on_body(self, body: bytes) -> None:
        """Restart the timeout for the next part of the body."""
        super().on_body(body)
        self._await_client()

    def on_message_complete(self) -> None:
        """Stop the receive timeout, unless the response was sent before the request was complete."""
        super().on_message_complete()
        if self.cycle.response_complete:
            self._await_client()
        else:
            self._stop_awaiting()

    def on_response_complete(self) -> None:
        """Mark the connection as idle, so that the limiter may close it."""
        super().on_response_complete()
        if not self.transport.is_closing() and (self.cycle is None or self.cycle.response_complete):
            self._door.awaited[self] = None

    def drop(self) -> None:
        """Close the connection at once, without a response."""
        self._door.release(self)
        self.transport.abort()

    def _await_client(self) -> None:
        self._stop_awaiting()
        self._door.awaited[self] = None
        self._timer = self.loop.call_later(self._door.patience, self._lose_patience)

    def _stop_awaiting(self) -> None:
        self._door.awaited.pop(self, None)
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _lose_patience(self) -> None:
        if self.flow is not None and self.flow.read_paused:  # it is us who do not read
            self._await_client()
        else:
            self.drop()


def raise_open_file_limit(wanted: int) -> int:
    """Raise the soft limit of open files as needed and return the number of connections that it allows."""
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = wanted + RESERVED_FILES
    if soft < needed:
        soft = needed if hard == resource.RLIM_INFINITY else min(needed, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    if soft < needed:
        _log.warning("the system allows %d open files; that is room for %d connections", soft, soft - RESERVED_FILES)
    return max(1, min(wanted, soft - RESERVED_FILES))
