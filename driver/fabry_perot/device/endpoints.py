"""Endpoints of a device's line: a serial port, or a socket pair in one process; both are non-blocking.

A TCP port is in :mod:`fabry_perot.device.tcp`.
"""

from __future__ import annotations

import socket
import time
from contextlib import suppress
from typing import Any, Protocol

import serial

CHUNK = 65536
MAX_QUEUED_BYTES = 0.02
"""Seconds of line time that may wait in the system: what waits there, an emergency stop's answer cannot overtake."""
REOPEN = 0.5
"""Seconds between two attempts to open a lost port."""


class Endpoint(Protocol):
    """Interface of a device's end of a line."""

    url: str

    def descriptors(self) -> list[int]:
        """Return the file descriptors to wait on for reading."""
        ...

    def writable_descriptor(self) -> int | None:
        """Return the descriptor to wait on for writing, if there is a peer."""
        ...

    def read(self, limit: int) -> bytes:
        """Return received bytes, at most ``limit``, without waiting."""
        ...

    def write(self, data: bytes) -> int:
        """Send as many bytes as the line accepts now, and return their number."""
        ...

    def close(self) -> None:
        """Close the endpoint and release its resources."""
        ...


class PairEndpoint:
    """Endpoint on one socket of a socket pair; the other socket belongs to a host in the same process.

    Parameters
    ----------
    end
        The socket.
    """

    url = "in this process"

    def __init__(self, end: socket.socket) -> None:
        end.setblocking(False)
        self._end = end

    def descriptors(self) -> list[int]:
        """Return the socket to wait on for reading."""
        return [self._end.fileno()]

    def writable_descriptor(self) -> int | None:
        """Return the socket to wait on for writing."""
        return self._end.fileno()

    def read(self, limit: int) -> bytes:
        """Return received bytes without waiting."""
        try:
            return self._end.recv(min(limit, CHUNK))
        except OSError:
            return b""

    def write(self, data: bytes) -> int:
        """Send as many bytes as fit; bytes to a disconnected host are dropped."""
        try:
            return self._end.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            return len(data)

    def close(self) -> None:
        """Close the socket."""
        self._end.close()


class SerialEndpoint:
    """Endpoint on a serial port, which is reopened after it was unplugged.

    Parameters
    ----------
    path
        Name of the port.
    baudrate
        Baud rate of a UART; USB ignores it.
    """

    def __init__(self, path: str, baudrate: int) -> None:
        self.url, self._baudrate = path, baudrate
        self._most = max(64, int(baudrate / 10 * MAX_QUEUED_BYTES))
        self._port: Any = None
        self._tried = 0.0
        self._open()

    def _open(self) -> None:
        self._port = serial.Serial(self.url, self._baudrate, timeout=0, write_timeout=0, exclusive=True)

    def descriptors(self) -> list[int]:
        """Return the serial port to wait on for reading, if it has a file descriptor."""
        return [self._port.fileno()] if self._port is not None and hasattr(self._port, "fileno") else []

    def writable_descriptor(self) -> int | None:
        """Return None: the buffer is limited by :data:`MAX_QUEUED_BYTES`, not by the system."""
        return None

    def read(self, limit: int) -> bytes:
        """Return received bytes; reopens a lost port when it is available again."""
        if self._port is None:
            self._reopen()
            return b""
        try:
            return bytes(self._port.read(min(limit, CHUNK)))
        except (serial.SerialException, OSError, TypeError):
            self._drop()
            return b""

    def write(self, data: bytes) -> int:
        """Send as many bytes as the system's buffer may hold; bytes are lost while the port is unplugged."""
        if self._port is None:
            return len(data)
        try:
            room = max(0, self._most - self._port.out_waiting)
            return int(self._port.write(data[:room]) or 0) if room else 0
        except (serial.SerialException, OSError, TypeError):
            self._drop()
            return len(data)

    def _drop(self) -> None:
        self.close()
        self._port = None

    def _reopen(self) -> None:
        if time.monotonic() - self._tried < REOPEN:
            return
        self._tried = time.monotonic()
        with suppress(serial.SerialException, OSError):
            self._open()

    def close(self) -> None:
        """Close the serial port."""
        if self._port is not None:
            with suppress(Exception):  # an unplugged port cannot be flushed, and need not be
                self._port.close()
