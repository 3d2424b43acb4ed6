"""Lines for an emergency stop: a free port, or a second connection to a device whose port is in use."""

from __future__ import annotations

import os
import select
import socket
from contextlib import suppress
from urllib.parse import urlsplit

from fabry_perot.errors import LinkLost
from fabry_perot.host.transport import Transport, open_transport

TURN = 0.01
"""Longest wait for bytes of a line, in s."""


class SecondConnection:
    """Second opening of a terminal that another program holds, which changes neither settings nor lock."""

    def __init__(self, path: str) -> None:
        self._file = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

    def read(self) -> bytes:
        """Return received bytes without waiting."""
        select.select([self._file], [], [], TURN)
        with suppress(BlockingIOError):
            return os.read(self._file, 4096)
        return b""

    def write(self, data: bytes) -> None:
        """Send as many bytes as fit, and return their number."""
        with suppress(BlockingIOError):
            os.write(self._file, data)

    def close(self) -> None:
        """Close this opening; the other program's opening is not affected."""
        os.close(self._file)


class TcpLine:
    """TCP connection to a device, possibly in parallel to another host's connection."""

    def __init__(self, url: str, timeout: float) -> None:
        parts = urlsplit(url)
        self._socket = socket.create_connection((parts.hostname or "", parts.port or 0), timeout)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(TURN)

    def read(self) -> bytes:
        """Return received bytes; raises LinkLost when the connection is closed."""
        try:
            data = self._socket.recv(4096)
        except TimeoutError:
            return b""
        if not data:
            raise LinkLost("the peer closed the connection")
        return data

    def write(self, data: bytes) -> None:
        """Send all of ``data``."""
        self._socket.sendall(data)

    def close(self) -> None:
        """Close the TCP connection."""
        self._socket.close()


def opened(url: str, baudrate: int | None) -> Transport:
    """Open a port; the baud rate is the default one unless given."""
    return open_transport(url, baudrate)
