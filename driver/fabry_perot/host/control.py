"""Control socket of a port's holder: other programs of the computer ask it to stop, to report, or to give way.

Every process that holds a port listens on a local socket for each of the port's names
(:func:`fabry_perot.host.ports.aliases`). One JSON line is asked, one is answered; PROTOCOL.md has both. On Linux the
sockets are in the abstract namespace, so nothing remains of a process that was killed; elsewhere they are files in the
folder for temporary files. Windows has none.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import selectors
import socket
import struct
import sys
import tempfile
import threading
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from fabry_perot.host.answers import PortStatus, StopAnswer, as_map
from fabry_perot.host.ports import aliases, lock_owner, may_open, own_name, program_of

log = logging.getLogger(__name__)
ABSTRACT = sys.platform == "linux"
AVAILABLE = hasattr(socket, "AF_UNIX")
_LONGEST = 4096
"""Longest request or answer, in bytes."""
_READING = 1.0
"""Seconds within which a request has to be complete."""
_MOST = 32
"""Clients at a time; the oldest has to go when one more comes."""
_PREFIX = "fabry-perot"
_LISTENS = 0x10000
"""Flag of a listening socket in /proc/net/unix; connections have its name, too."""


class Holder(Protocol):
    """A program's hold on a port, as others may ask after it."""

    def stop(self, who: str, timeout: float) -> StopAnswer:
        """Turn the laser off and return what the device says afterwards, within ``timeout`` s."""
        ...

    def port_status(self) -> PortStatus | None:
        """Return the device's last STATUS; ``None`` before the first."""
        ...

    def give_way(self) -> bool:
        """Release the port for another program; return whether that was done."""
        ...


@dataclass(frozen=True, slots=True)
class Peer:
    """The process at the other end of a local socket; -1 where the system does not tell."""

    pid: int
    uid: int
    gid: int


@dataclass(frozen=True, slots=True)
class Listener:
    """A control socket that some process listens on.

    Parameters
    ----------
    pid
        The process, by the socket's name.
    address
        Address of the socket.
    """

    pid: int
    address: str


def _digest(alias: str) -> str:
    return hashlib.sha256(alias.encode("utf-8", "surrogateescape")).hexdigest()[:24]


def _folder() -> Path:
    return Path("/tmp") if os.path.isdir("/tmp") else Path(tempfile.gettempdir())  # noqa: S108  # one for all users


class ControlServer:
    """Listening sockets of one holder, served by a daemon thread.

    Parameters
    ----------
    holder
        Asked from that thread's helpers, one thread a request.
    url
        The port; :meth:`bind` again after it was opened anew.
    """

    _count = 0

    def __init__(self, holder: Holder, url: str) -> None:
        self._holder, self._url = holder, url
        self._bound: dict[str, socket.socket] = {}
        self._clients: list[socket.socket] = []
        self._lock = threading.Lock()
        self._closed = False
        ControlServer._count += 1
        self._number = ControlServer._count
        if not AVAILABLE:
            return
        self._wake, self._woken = socket.socketpair()
        self.bind()
        threading.Thread(target=self._run, name="fabry-perot-control", daemon=True).start()

    def bind(self) -> None:
        """Listen under all names that the port has now."""
        if not AVAILABLE:
            return
        for alias in aliases(self._url):
            with self._lock:
                if alias in self._bound or self._closed:
                    continue
                try:
                    self._bound[alias] = _listen(_address(alias, os.getpid(), self._number))
                except OSError as error:
                    log.warning("no control socket for %s: %s", alias, error)
        with suppress(OSError):
            self._wake.send(b"x")

    def close(self) -> None:
        """Listen no more."""
        if not AVAILABLE:
            return
        with self._lock:
            self._closed = True
            bound = list(self._bound.values())
        with suppress(OSError):
            self._wake.send(b"x")
        for listener in bound:
            address = listener.getsockname()
            listener.close()
            if isinstance(address, str) and address and not address.startswith("\0"):
                Path(address).unlink(missing_ok=True)

    def _run(self) -> None:
        watched: dict[str, socket.socket] = {}
        with selectors.DefaultSelector() as selector:
            selector.register(self._woken, selectors.EVENT_READ)
            while not self._closed:
                with self._lock:
                    fresh = {alias: each for alias, each in self._bound.items() if alias not in watched}
                for alias, each in fresh.items():
                    with suppress(OSError, ValueError):
                        selector.register(each, selectors.EVENT_READ)
                    watched[alias] = each
                for key, _ in selector.select():
                    self._serve(key.fileobj)
        self._wake.close()
        self._woken.close()

    def _serve(self, ready: Any) -> None:
        if ready is self._woken:
            with suppress(OSError):
                self._woken.recv(4096)
            return
        try:
            client, _ = ready.accept()
        except OSError:
            return
        with self._lock:
            self._clients.append(client)
            oldest = self._clients.pop(0) if len(self._clients) > _MOST else None
        if oldest is not None:
            with suppress(OSError):
                oldest.shutdown(socket.SHUT_RDWR)
        threading.Thread(target=self._attend, args=(client,), name="fabry-perot-control", daemon=True).start()

    def _attend(self, client: socket.socket) -> None:
        try:
            with client:
                line = _read_line(client, _READING)
                with self._lock:  # a request that is complete does not count among those that may be slow
                    if client in self._clients:
                        self._clients.remove(client)
                client.settimeout(_READING)
                client.sendall(json.dumps(self._answer(line, peer_of(client))).encode() + b"\n")
        except OSError:
            return
        finally:
            with self._lock:
                if client in self._clients:
                    self._clients.remove(client)

    def _answer(self, line: bytes, peer: Peer) -> dict[str, Any]:
        head = {"holder": f"{own_name()} (process {os.getpid()})"}
        try:
            asked = json.loads(line)
            do = asked["do"]
            if do == "stop":
                who = _printable(asked.get("who")) or _user(peer)
                timeout = min(5.0, max(0.1, float(asked.get("seconds", 1.5))))
                log.warning("emergency stop from %s (%s)", who, program_of(peer.pid))
                outcome = self._holder.stop(who, timeout)
                return head | {name: getattr(outcome, name) for name in StopAnswer.__slots__ if name != "holder"}
            if do == "status":
                status = self._holder.port_status()
                return head | {"status": None if status is None else as_map(status)}
            if do == "yield":
                return head | {"yielded": self._may_ask(peer) and self._holder.give_way()}
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            return head | {"error": f"{type(error).__name__}: {error}"}
        return head | {"error": f"do is {str(do)[:40]!r}; allowed: stop | status | yield"}

    def _may_ask(self, peer: Peer) -> bool:
        """Whether a process may have the port: of this user or the administrator, or allowed to open it anyway."""
        if peer.uid in (0, os.geteuid()) or "://" in self._url:
            return True
        return peer.uid >= 0 and may_open(self._url, peer.uid, peer.gid, peer.pid)


def _listen(address: str) -> socket.socket:
    if not address.startswith("\0"):
        Path(address).unlink(missing_ok=True)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listener.bind(address)
        if not address.startswith("\0"):
            os.chmod(address, 0o666)  # noqa: S103  # every user may stop the laser
        listener.listen(16)
        listener.setblocking(False)
    except OSError:
        listener.close()
        raise
    return listener


def _address(alias: str, pid: int, number: int) -> str:
    if ABSTRACT:
        return f"\0{_PREFIX}/{_digest(alias)}/{pid}/{number}"
    return str(_folder() / f"{_PREFIX}-{_digest(alias)}-{pid}-{number}")


def _read_line(client: socket.socket, seconds: float) -> bytes:
    """Return one line; raises OSError when it is too long or too late."""
    deadline, data = time.monotonic() + seconds, b""
    while not data.endswith(b"\n"):
        left = deadline - time.monotonic()
        if left <= 0 or len(data) > _LONGEST:
            raise TimeoutError("no whole line")
        client.settimeout(left)
        piece = client.recv(_LONGEST)
        if not piece:
            raise ConnectionError("no whole line")
        data += piece
    return data


def peer_of(client: socket.socket) -> Peer:
    """Return the process at the other end, as the system says."""
    if hasattr(socket, "SO_PEERCRED"):
        with suppress(OSError):
            layout = struct.Struct("3i")
            return Peer(*layout.unpack(client.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, layout.size)))
    return Peer(-1, -1, -1)


def _printable(text: object) -> str:
    return "".join(letter for letter in str(text or "") if letter.isprintable())[:200].strip()


def _user(peer: Peer) -> str:
    with suppress(ImportError, KeyError):
        import pwd

        return pwd.getpwuid(peer.uid).pw_name
    return f"user {peer.uid}" if peer.uid >= 0 else "another program"


def listeners(url: str) -> list[Listener]:
    """Return the control sockets of a port; of a terminal that is locked only those of the process that locked it.

    Parameters
    ----------
    url
        A device path or a pyserial URL.
    """
    if not AVAILABLE:
        return []
    owner = lock_owner(url)
    wanted = {_digest(alias) for alias in aliases(url)}
    found = {}
    for each in _all_listeners():
        words = _words_of(each.address)
        if words[0] in wanted and owner in (None, 0, each.pid):
            found[each.pid, words[2]] = each  # one of the names of one holder
    return list(found.values())


def _words_of(address: str) -> list[str]:
    """Return digest of the port's name, process and number of the holder in it."""
    return address.split("/")[1:] if address.startswith("\0") else Path(address).name.split("-")[2:]


def _all_listeners() -> Iterable[Listener]:
    if ABSTRACT:
        with suppress(OSError):
            for line in Path("/proc/net/unix").read_text(errors="replace").splitlines():
                name = line.rpartition(" ")[2]
                parts = name.split("/")
                listens = int(line.split()[3], 16) & _LISTENS if parts[0].startswith("@") else 0
                if listens and parts[0] == f"@{_PREFIX}" and len(parts) == 4 and parts[2].isdecimal():
                    yield Listener(int(parts[2]), "\0" + name[1:])
        return
    with suppress(OSError):
        for path in _folder().glob(f"{_PREFIX}-*-*-*"):
            pid = path.name.split("-")[3]
            if pid.isdecimal():
                yield Listener(int(pid), str(path))


@dataclass(frozen=True, slots=True)
class Reply:
    """Answer of a holder.

    Parameters
    ----------
    holder
        Program and process, the latter as the system says.
    peer
        That process.
    body
        The JSON object.
    """

    holder: str
    peer: Peer
    body: dict[str, Any]


def ask(listener: Listener, timeout: float, **request: Any) -> Reply | None:
    """Ask a holder and return its answer.

    ``None`` stands for a holder that does not answer in time, answers something else than an object, or is not the
    process that the socket's name says.

    Parameters
    ----------
    listener
        Its socket.
    timeout
        Longest wait in s.
    request
        The request's fields, ``do`` among them.
    """
    deadline = time.monotonic() + timeout
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
            client.settimeout(timeout)
            client.connect(listener.address)
            peer = peer_of(client)
            if peer.uid == -1 and not listener.address.startswith("\0"):
                peer = Peer(-1, os.stat(listener.address).st_uid, -1)
            if peer.pid not in (-1, 0, listener.pid):
                return None
            client.sendall(json.dumps(request).encode() + b"\n")
            body = json.loads(_read_line(client, deadline - time.monotonic()))
    except ConnectionRefusedError:
        if not listener.address.startswith("\0"):
            with suppress(OSError):
                Path(listener.address).unlink(missing_ok=True)  # of a process that was killed
        return None
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(body, dict):
        return None
    name = _printable(body.get("holder")).partition(" (process")[0] or "another program"
    return Reply(f"{name} (process {listener.pid})", peer, body)


def is_trusted(url: str, listener: Listener, reply: Reply) -> bool:
    """Return whether an answer is that of the process that holds the port.

    Of a locked terminal it has to be the process that locked it; otherwise a process of this user or the administrator,
    so that no other user can answer for a holder.

    Parameters
    ----------
    url
        The port.
    listener, reply
        Who was asked, and the answer.
    """
    owner = lock_owner(url)
    if owner:
        return owner == listener.pid
    return reply.peer.uid in (0, os.geteuid())
