"""Where the simulated device's line comes out: a pseudo-terminal or a TCP port, both without blocking."""

from __future__ import annotations

import os
import socket
import tty
from pathlib import Path
from typing import Protocol

CHUNK = 65536


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
    """A TCP port for one client at a time; a second one is turned away.

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
        self._unplugged = False
        name = self._listener.getsockname()
        self.url = f"socket://{name[0]}:{name[1]}"

    def descriptors(self) -> list[int]:
        """Return listener and client."""
        return [self._listener.fileno(), *([self._client.fileno()] if self._client else [])]

    def writable_descriptor(self) -> int | None:
        """Return the client."""
        return self._client.fileno() if self._client else None

    def read(self, limit: int) -> bytes:
        """Return what has arrived; takes a new client when there is none."""
        self._accept()
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
        self._listener.close()

    def _accept(self) -> None:
        try:
            client, _ = self._listener.accept()
        except OSError:
            return
        if self._client is not None or self._unplugged:
            client.close()
            return
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._client = client

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None
