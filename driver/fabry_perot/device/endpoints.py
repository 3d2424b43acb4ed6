"""Where a device's line comes out: a TCP port, a serial port, a pair of sockets in one process; none of them blocks."""

from __future__ import annotations

import select
import socket
import time
from contextlib import suppress
from typing import Any, Protocol

import serial

from fabry_perot.wire.codes import Type
from fabry_perot.wire.framing import FLAG_URGENT, Frame, encode_frame

CHUNK = 65536
MOST_REFUSED = 8
"""Clients that may wait to hear that another one is connected."""
QUEUED = 0.02
"""Seconds of line time that may wait in the system: what waits there, an emergency stop's answer cannot overtake."""
REOPEN = 0.5
"""Seconds between two attempts to open a lost port."""


class Endpoint(Protocol):
    """One end of a line."""

    url: str

    def descriptors(self) -> list[int]:
        """Return the file descriptors to wait on for reading."""
        ...

    def writable_descriptor(self) -> int | None:
        """Return the descriptor to wait on for writing, if there is a peer."""
        ...

    def read(self, limit: int) -> bytes:
        """Return what has arrived, at most ``limit`` bytes, without waiting."""
        ...

    def write(self, data: bytes) -> int:
        """Send what the line takes now and return how many bytes that was."""
        ...

    def close(self) -> None:
        """Give everything back."""
        ...


class TcpEndpoint:
    """A TCP port for one client at a time; a second one is told who is there and turned away.

    Parameters
    ----------
    address
        ``HOST:PORT``.
    """

    def __init__(self, address: str) -> None:
        host, _, port = address.rpartition(":")
        self._listener = socket.create_server((host or "127.0.0.1", int(port)), backlog=4)
        self._listener.setblocking(False)
        self._client: socket.socket | None = None
        self._refused: list[socket.socket] = []
        self._unplugged = False
        name = self._listener.getsockname()
        self.url = f"socket://{name[0]}:{name[1]}"

    def descriptors(self) -> list[int]:
        """Return listener and clients."""
        clients = [*self._refused, *([self._client] if self._client else [])]
        return [self._listener.fileno(), *(client.fileno() for client in clients)]

    def writable_descriptor(self) -> int | None:
        """Return the client."""
        return self._client.fileno() if self._client else None

    def read(self, limit: int) -> bytes:
        """Return what has arrived; takes a new client when there is none."""
        self._accept()
        self._turn_away()
        if self._client is None:
            return b""
        try:
            data = self._client.recv(min(limit, CHUNK))
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._drop()
        return data

    def write(self, data: bytes) -> int:
        """Send what fits; without a client the bytes are lost, as on a line nobody listens to."""
        if self._client is None:
            return len(data)
        try:
            return self._client.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            self._drop()
            return len(data)

    def unplug(self) -> None:
        """Drop the client and turn others away."""
        self._unplugged = True
        self._drop()

    def plug(self) -> None:
        """Take clients again."""
        self._unplugged = False

    def close(self) -> None:
        """Close everything."""
        self._drop()
        for client in self._refused:
            client.close()
        self._listener.close()

    def _accept(self) -> None:
        try:
            client, _ = self._listener.accept()
        except OSError:
            return
        if self._client is not None and _has_left(self._client):
            self._drop()
        if self._unplugged or len(self._refused) >= MOST_REFUSED:
            client.close()
            return
        client.setblocking(False)
        if self._client is not None:
            self._refused.append(client)
            return
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._client = client

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None

    def _turn_away(self) -> None:
        """Answer whatever those say who came while another was connected by who that is, until they leave."""
        for client in list(self._refused):
            try:
                said = client.recv(CHUNK)
                if said and self._client is not None:
                    host, port = self._client.getpeername()[:2]
                    client.send(encode_frame(Frame(Type.BUSY, FLAG_URGENT, 0, 0, 0, f"{host}:{port}".encode())))
            except BlockingIOError:
                continue
            except OSError:
                said = b""
            if not said or self._client is None:
                self._refused.remove(client)
                client.close()


def _has_left(client: socket.socket) -> bool:
    """Tell whether a client has closed its end, even if bytes of it wait to be read (where the system can tell)."""
    if not hasattr(select, "poll"):  # Windows
        try:
            return not client.recv(1, socket.MSG_PEEK)
        except OSError:
            return False
    poller = select.poll()
    poller.register(client, select.POLLHUP | select.POLLERR | getattr(select, "POLLRDHUP", 0))
    return bool(poller.poll(0))


class PairEndpoint:
    """One end of a pair of sockets, whose other end is a host in the same process.

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
        """Return the socket."""
        return [self._end.fileno()]

    def writable_descriptor(self) -> int | None:
        """Return the socket."""
        return self._end.fileno()

    def read(self, limit: int) -> bytes:
        """Return what has arrived."""
        try:
            return self._end.recv(min(limit, CHUNK))
        except OSError:
            return b""

    def write(self, data: bytes) -> int:
        """Send what fits; to a host that has gone, into the void."""
        try:
            return self._end.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            return len(data)

    def close(self) -> None:
        """Close it."""
        self._end.close()


class SerialEndpoint:
    """A serial port; one that is unplugged is looked for until it is back.

    Parameters
    ----------
    path
        Name of the port.
    baudrate
        Baud rate of a UART; USB ignores it.
    """

    def __init__(self, path: str, baudrate: int) -> None:
        self.url, self._baudrate = path, baudrate
        self._most = max(64, int(baudrate / 10 * QUEUED))
        self._port: Any = None
        self._tried = 0.0
        self._open()

    def _open(self) -> None:
        self._port = serial.Serial(self.url, self._baudrate, timeout=0, write_timeout=0, exclusive=True)

    def descriptors(self) -> list[int]:
        """Return the port, where it has a descriptor to wait on."""
        return [self._port.fileno()] if self._port is not None and hasattr(self._port, "fileno") else []

    def writable_descriptor(self) -> int | None:
        """Return nothing: what may wait is limited by :data:`QUEUED`, not by the system."""
        return None

    def read(self, limit: int) -> bytes:
        """Return what has arrived; opens a lost port anew when it is back."""
        if self._port is None:
            self._reopen()
            return b""
        try:
            return bytes(self._port.read(min(limit, CHUNK)))
        except (serial.SerialException, OSError, TypeError):
            self._drop()
            return b""

    def write(self, data: bytes) -> int:
        """Send as much as may wait in the system; without a port the bytes are lost."""
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
        """Give the port back."""
        if self._port is not None:
            with suppress(Exception):  # an unplugged port cannot be flushed, and need not be
                self._port.close()
