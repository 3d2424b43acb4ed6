"""TCP port of a device, for one host (after its HELLO) and for observers, which may send ABORT and read STATUS.

``PROTOCOL.md``, section *TCP endpoints*, has the rules; nothing here blocks.
"""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from fabry_perot.device.endpoints import CHUNK
from fabry_perot.wire.constants import Type
from fabry_perot.wire.framing import FLAG_URGENT, MAX_PAYLOAD, VERSION, Deframer, Frame, encode_frame, encoded_size

SILENCE = 4.0
"""A host of which nothing was heard for so many s loses its place to the next client that says HELLO."""
STOPPING = 1.0
"""For so many s after an observer's ABORT, bytes that the host does not read are lost, and hold up no answer."""
MOST_OBSERVERS = 16
"""Clients beside the host; one more displaces the observer that was silent for longest."""
PROBES = {"TCP_KEEPIDLE": 5, "TCP_KEEPINTVL": 2, "TCP_KEEPCNT": 3}
"""TCP keep-alive, in s and probes: a computer without power or cable is noticed after about 11 s."""
UNREAD = 11_000
"""TCP_USER_TIMEOUT in ms: the same for bytes on their way, which keep-alive does not count."""
_COPIED = frozenset({Type.STATUS, Type.ABORT_ACK})
"""What observers receive of that which the device sends."""
_LONGEST = encoded_size(MAX_PAYLOAD)


@dataclass(slots=True, eq=False)
class _Client:
    """TCP connection of a client; ``heard`` is the time of its last bytes, in s of the endpoint's clock."""

    socket: socket.socket
    heard: float
    pending: bytearray = field(default_factory=bytearray)

    def receive(self, limit: int, now: float) -> bytes | None:
        """Return received bytes, ``None`` if there are none, and empty bytes at the end of the connection."""
        try:
            data = self.socket.recv(limit)
        except BlockingIOError:
            return None
        except OSError:
            return b""
        self.heard = now
        return data

    def send(self, data: bytes) -> None:
        """Send ``data`` without waiting; bytes that an observer does not read in time are dropped."""
        try:
            self.socket.send(data)
        except OSError:
            return

    def next_frame(self) -> bytes | None:
        """Return the bytes of the next complete received frame, without delimiters; ``None`` if there is none."""
        end = self.pending.find(0)
        if end < 0:
            if len(self.pending) > _LONGEST:
                self.pending.clear()
            return None
        chunk = bytes(self.pending[:end])
        del self.pending[: end + 1]
        return chunk

    def has_left(self) -> bool:
        """Return whether the client has closed its end, even if bytes are unread (where the system reports this)."""
        if not hasattr(select, "poll"):  # Windows
            try:
                return not self.socket.recv(1, socket.MSG_PEEK)
            except OSError:
                return False
        poller = select.poll()
        poller.register(self.socket, select.POLLHUP | select.POLLERR | getattr(select, "POLLRDHUP", 0))
        return bool(poller.poll(0))


class TcpEndpoint:
    """Endpoint on a TCP port, for one host at a time and for observers.

    Parameters
    ----------
    address
        ``HOST:PORT``.
    clock
        Returns seconds; only differences count.
    """

    def __init__(self, address: str, clock: Callable[[], float] = time.monotonic) -> None:
        host, _, port = address.rpartition(":")
        self._listener = socket.create_server((host or "127.0.0.1", int(port)), backlog=4)
        self._listener.setblocking(False)
        self._clock = clock
        self._host: _Client | None = None
        self._observers: list[_Client] = []
        self._unplugged = False
        self._stopping_until = 0.0
        self._tail = b""
        name = self._listener.getsockname()
        self.url = f"socket://{name[0]}:{name[1]}"

    def descriptors(self) -> list[int]:
        """Return the sockets of listener and clients to wait on for reading."""
        clients = [*self._observers, *([self._host] if self._host else [])]
        return [self._listener.fileno(), *(client.socket.fileno() for client in clients)]

    def writable_descriptor(self) -> int | None:
        """Return the host's socket to wait on for writing."""
        return self._host.socket.fileno() if self._host else None

    def read(self, limit: int) -> bytes:
        """Return the host's bytes, at most ``limit``, after any ABORTs of observers."""
        now = self._clock()
        self._accept(now)
        data = b""
        if self._host is not None and limit > 0:
            received = self._host.receive(min(limit, CHUNK), now)
            if received == b"":
                self._drop()
            data = received or b""
        for observer in list(self._observers):
            received = observer.receive(CHUNK, now)
            if received == b"":
                self._observers.remove(observer)
                observer.socket.close()
                continue
            observer.pending += received or b""
            data = self._hear(observer, now) + data
        return data

    def _hear(self, observer: _Client, now: float) -> bytes:
        """Return an observer's frames for the device: ABORT, or all frames from its HELLO if it becomes the host."""
        heard = b""
        while (chunk := observer.next_frame()) is not None:
            kind = _kind(chunk)
            if kind == Type.ABORT:
                self._stopping_until = now + STOPPING
                heard += b"\0" + chunk + b"\0"
            elif kind == Type.HELLO:
                if self._host is not None and now - self._host.heard > SILENCE:
                    self._drop()
                if self._host is None:
                    self._observers.remove(observer)
                    self._host = observer
                    return heard + b"\0" + chunk + b"\0" + bytes(observer.pending)
                if self._host.has_left():  # its last bytes are read first
                    observer.pending[:0] = chunk + b"\0"
                    return heard
                self._refuse(observer, self._host)
        return heard

    def write(self, data: bytes) -> int:
        """Send to the host as many bytes as fit, and copies of STATUS and ABORT_ACK to observers.

        Without a host, bytes are dropped.
        """
        taken = self._to_host(data)
        if not self._observers:
            self._tail = b""
            return taken
        *chunks, self._tail = (self._tail + data[:taken]).split(b"\0")
        if len(self._tail) > _LONGEST:
            self._tail = b""
        for chunk in chunks:
            if len(chunk) > 2 and chunk[1] == VERSION and chunk[2] in _COPIED:  # neither is 0, so stuffing leaves both
                for observer in self._observers:
                    observer.send(b"\0" + chunk + b"\0")
        return taken

    def _to_host(self, data: bytes) -> int:
        if self._host is None:
            return len(data)
        try:
            return self._host.socket.send(data)
        except BlockingIOError:
            now = self._clock()
            if now - self._host.heard <= SILENCE:
                return len(data) if now < self._stopping_until else 0
            self._drop()
        except OSError:
            self._drop()
        return len(data)

    def unplug(self) -> None:
        """Close all connections and reject new ones, like an unplugged line."""
        self._unplugged = True
        self._drop()
        for observer in self._observers:
            observer.socket.close()
        self._observers.clear()

    def plug(self) -> None:
        """Accept connections again."""
        self._unplugged = False

    def close(self) -> None:
        """Close the listener and all connections."""
        self.unplug()
        self._listener.close()

    def _accept(self, now: float) -> None:
        try:
            client, _ = self._listener.accept()
        except OSError:
            return
        if self._unplugged:
            client.close()
            return
        if len(self._observers) >= MOST_OBSERVERS:
            oldest = min(self._observers, key=lambda observer: observer.heard)
            self._observers.remove(oldest)
            oldest.socket.close()
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        _keep_alive(client)
        self._observers.append(_Client(client, now))

    def _drop(self) -> None:
        if self._host is not None:
            self._host.socket.close()
            self._host = None

    @staticmethod
    def _refuse(observer: _Client, host: _Client) -> None:
        """Reply BUSY, with the address of the connected host, to an observer's HELLO."""
        try:
            address, port = host.socket.getpeername()[:2]
        except OSError:  # it leaves at this moment; HELLO is repeated
            return
        observer.send(encode_frame(Frame(Type.BUSY, FLAG_URGENT, 0, 0, 0, f"{address}:{port}".encode())))


def _kind(chunk: bytes) -> int | None:
    """Return the message type of a valid frame; ``None`` for an invalid frame."""
    frames = Deframer().feed(chunk + b"\0")
    return frames[0].type if frames else None


def _keep_alive(client: socket.socket) -> None:
    """Enable TCP keep-alive, as far as the system supports it."""
    client.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in PROBES.items():
        if hasattr(socket, name):
            client.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
    if hasattr(socket, "TCP_USER_TIMEOUT"):
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNREAD)
