"""Where the simulated device's line comes out: a pseudo-terminal or a TCP port, both without blocking."""

from __future__ import annotations

import os
import select
import socket
import tty
from pathlib import Path
from typing import Protocol

from fabry_perot.wire.codes import Type
from fabry_perot.wire.framing import FLAG_URGENT, Frame, encode_frame

CHUNK = 65536
MOST_REFUSED = 8
"""Clients that may wait to hear that another one is connected."""


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

    def unplug(self) -> None:
        """Take the line away from whoever uses it."""
        ...

    def plug(self) -> None:
        """Bring it back."""
        ...

    def close(self) -> None:
        """Give everything back."""
        ...


class PtyEndpoint:
    """A pseudo-terminal.

    Parameters
    ----------
    link
        Path of a symbolic link to make, replacing an older link.
    """

    def __init__(self, link: str | None = None) -> None:
        self._link = Path(link) if link else None
        self._master = self._slave = -1
        self.plug()

    def plug(self) -> None:
        """Make a pseudo-terminal and link it."""
        self._master, self._slave = os.openpty()  # the open slave keeps the line up between two hosts
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.url = os.ttyname(self._slave)
        if self._link is not None:
            fresh = self._link.with_name(f"{self._link.name}.{os.getpid()}")
            if self._link.exists() and not self._link.is_symlink():
                raise FileExistsError(f"{self._link} exists and is no symbolic link")
            fresh.symlink_to(self.url)
            fresh.replace(self._link)

    def descriptors(self) -> list[int]:
        """Return the master."""
        return [self._master] if self._master >= 0 else []

    def writable_descriptor(self) -> int | None:
        """Return the master."""
        return self._master if self._master >= 0 else None

    def read(self, limit: int) -> bytes:
        """Return what has arrived."""
        try:
            return os.read(self._master, min(limit, CHUNK))
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> int:
        """Send what fits."""
        try:
            return os.write(self._master, data)
        except BlockingIOError:
            return 0

    def unplug(self) -> None:
        """Close the pseudo-terminal and remove the link."""
        if self._master < 0:
            return
        os.close(self._master)
        os.close(self._slave)
        self._master = self._slave = -1
        if self._link is not None and self._link.is_symlink() and os.readlink(self._link) == self.url:
            self._link.unlink()

    def close(self) -> None:
        """Give everything back."""
        self.unplug()


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
    """Tell whether a client has closed its end, even if bytes of it wait to be read."""
    poller = select.poll()
    poller.register(client, select.POLLHUP | select.POLLERR | getattr(select, "POLLRDHUP", 0))
    return bool(poller.poll(0))
