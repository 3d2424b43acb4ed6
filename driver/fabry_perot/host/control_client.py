"""Client of control sockets, through which other programs request stop, status or release of a port from its holder.

Every process that holds a port listens on a local socket for each of the port's names
(:func:`fabry_perot.host.port_usage.aliases`). One JSON line is the request, one the response; PROTOCOL.md has
both. On Linux the sockets are in the abstract namespace, so nothing of a killed process remains; elsewhere they
are files in the folder for temporary files. Windows has none.
"""

from __future__ import annotations

import hashlib
import json
import os
import socket
import struct
import sys
import tempfile
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fabry_perot.host.port_usage import aliases, lock_owner

ABSTRACT = sys.platform == "linux"
AVAILABLE = hasattr(socket, "AF_UNIX")
_LONGEST = 4096
"""Longest request or answer, in bytes."""
_PREFIX = "fabry-perot"
_LISTENS = 0x10000
"""Flag of a listening socket in /proc/net/unix; connections have its name, too."""


@dataclass(frozen=True, slots=True)
class Peer:
    """Process at the other end of a local socket; -1 where the system does not report it."""

    pid: int
    uid: int
    gid: int


@dataclass(frozen=True, slots=True)
class Listener:
    """Control socket of a process that holds a port.

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


def address(alias: str, pid: int, number: int) -> str:
    """Return the address of a control socket, from port name, process and number of the holder in this process."""
    if ABSTRACT:
        return f"\0{_PREFIX}/{_digest(alias)}/{pid}/{number}"
    return str(_folder() / f"{_PREFIX}-{_digest(alias)}-{pid}-{number}")


def read_line(client: socket.socket, seconds: float) -> bytes:
    """Read one line from a socket; raises OSError when it is too long or too late."""
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
    """Return the process at the other end of a socket, as reported by the system."""
    if hasattr(socket, "SO_PEERCRED"):
        with suppress(OSError):
            layout = struct.Struct("3i")
            return Peer(*layout.unpack(client.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, layout.size)))
    return Peer(-1, -1, -1)


def printable(text: object) -> str:
    """Return the printable characters of another program's text."""
    return "".join(letter for letter in str(text or "") if letter.isprintable())[:200].strip()


def listeners(url: str) -> list[Listener]:
    """Return the control sockets of a port; for a locked terminal, only those of the process with the lock.

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
    """Return digest of the port's name, process and holder number from a control socket's address."""
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
            if pid.isdecimal() and _lives(int(pid)):
                yield Listener(int(pid), str(path))
            else:
                with suppress(OSError):
                    path.unlink(missing_ok=True)


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


@dataclass(frozen=True, slots=True)
class Reply:
    """Reply of a port's holder on its control socket.

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
    """Send a request to a port's holder and return its reply.

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
            body = json.loads(read_line(client, deadline - time.monotonic()))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(body, dict):
        return None
    name = printable(body.get("holder")).partition(" (process")[0] or "another program"
    return Reply(f"{name} (process {listener.pid})", peer, body)


def is_trusted(url: str, listener: Listener, reply: Reply) -> bool:
    """Return whether a reply comes from the process that really holds the port.

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
