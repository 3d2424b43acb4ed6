"""Lookup of the user id of a loopback connection's client process, in Linux's socket tables."""

from __future__ import annotations

import os
import socket
import struct
from contextlib import suppress
from ipaddress import ip_address
from pathlib import Path
from typing import Final

Address = tuple[str, int | None]
GONE: Final = -1
"""The process has closed its end, so that nothing tells any more whose it was."""
_DIAG, _BY_FAMILY, _ERROR, _ENOENT = 4, 20, 2, 2
_HEAD = struct.Struct("=IHHII")
_SOCKET = struct.Struct("!HH16s16s12s")
"""Ports and addresses of ``inet_diag_sockid``, with interface and cookie."""
_ANY = bytes(4) + b"\xff" * 8
_ASKED = struct.Struct("=BBBBI")
_UID = struct.Struct("=II")
_UID_AT = _HEAD.size + 4 + _SOCKET.size + 12


class Peer:
    """Client end of a TCP connection, with a lookup of the user id of its process.

    Parameters
    ----------
    client, server
        Addresses and ports of both ends, as this process has them.
    """

    def __init__(self, client: Address | None, server: Address | None) -> None:
        self._ends = (client, server)
        self._user: int | None = None

    @property
    def user(self) -> int | None:
        """User id of the client process; :data:`GONE` for a closed socket, or ``None`` if not reported."""
        client, server = self._ends
        if client is None or server is None or client[1] is None or server[1] is None:
            return None  # no TCP
        if self._user is None or self._user == GONE:
            self._user = user_of((client[0], client[1]), (server[0], server[1]))
        return self._user


def user_of(client: tuple[str, int], server: tuple[str, int]) -> int | None:
    """Return the user id of the client process of a TCP connection between two addresses.

    Returns
    -------
    int or None
        User id, :data:`GONE`, or ``None`` where the system does not report one (not Linux).
    """
    try:
        return _ask_kernel(client, server)
    except (OSError, AttributeError, ValueError):
        with suppress(OSError, ValueError):
            return _look_up(client, server)
    return None


def _ask_kernel(client: tuple[str, int], server: tuple[str, int]) -> int:
    """Query the kernel (netlink ``inet_diag``) for the user id of a socket; :data:`GONE` without a process."""
    ends = [ip_address(host).packed for host, _ in (client, server)]
    family = socket.AF_INET if len(ends[0]) == 4 else socket.AF_INET6
    sought = _SOCKET.pack(client[1], server[1], *(end.ljust(16, b"\0") for end in ends), _ANY)
    body = _ASKED.pack(family, socket.IPPROTO_TCP, 0, 0, 0xFFFFFFFF) + sought
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, _DIAG) as kernel:
        kernel.settimeout(1.0)
        kernel.sendto(_HEAD.pack(_HEAD.size + len(body), _BY_FAMILY, 1, 1, 0) + body, (0, 0))
        answer = kernel.recv(4096)
    if _HEAD.unpack_from(answer)[1] == _ERROR:
        (number,) = struct.unpack_from("=i", answer, _HEAD.size)
        if number != -_ENOENT:
            raise OSError(-number, os.strerror(-number))
        return GONE
    user, inode = _UID.unpack_from(answer, _UID_AT)
    return user if inode else GONE


def _look_up(client: tuple[str, int], server: tuple[str, int]) -> int:
    """Read the user id of a socket from ``/proc/net/tcp``, where the kernel does not answer netlink queries."""
    ends = [(ip_address(host).packed, port) for host, port in (client, server)]
    words = [[host[n : n + 4][::-1].hex() for n in range(0, len(host), 4)] for host, _ in ends]
    told = " ".join(f"{''.join(word)}:{port:04x}" for word, (_, port) in zip(words, ends, strict=True)).upper()
    table = Path("/proc/net/tcp" if len(ends[0][0]) == 4 else "/proc/net/tcp6").read_text("ascii")
    for line in table.splitlines():
        if f" {told} " in line:
            _, _, _, _, _, _, _, user, _, inode, *_ = line.split()
            return int(user) if int(inode) else GONE
    return GONE
