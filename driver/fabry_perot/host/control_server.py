"""Control socket server of a port's holder, which serves requests of other programs in a thread."""

from __future__ import annotations

import json
import logging
import os
import selectors
import socket
import threading
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from fabry_perot.host import control_client
from fabry_perot.host.port_usage import aliases, may_open, own_name, program_of
from fabry_perot.host.stop_and_status_results import PortStatus, StopAnswer, as_map

log = logging.getLogger(__name__)
_READING = 1.0
"""Seconds within which a request has to be complete."""
_MOST = 32
"""Clients at a time whose request is not complete; the oldest has to go when one more comes."""


class Holder(Protocol):
    """Interface (typing protocol) of a program that holds a port: stop, status and release."""

    def stop(self, who: str, timeout: float) -> StopAnswer:
        """Turn the laser off and return the device's state afterwards, within ``timeout`` s."""
        ...

    def port_status(self) -> PortStatus | None:
        """Return the device's last STATUS; ``None`` before the first."""
        ...

    def give_way(self) -> bool:
        """Release the port for another program; return whether it was released."""
        ...


class ControlServer:
    """Control sockets of one holder, served by a daemon thread.

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
        if not control_client.AVAILABLE:
            return
        self._wake, self._woken = socket.socketpair()
        self.bind()
        threading.Thread(target=self._run, name="fabry-perot-control", daemon=True).start()

    def bind(self) -> None:
        """Listen under all present names of the port."""
        if not control_client.AVAILABLE:
            return
        for alias in aliases(self._url):
            with self._lock:
                if alias in self._bound or self._closed:
                    continue
                try:
                    self._bound[alias] = _listen(control_client.address(alias, os.getpid(), self._number))
                except OSError as error:
                    log.warning("no control socket for %s: %s", alias, error)
        with suppress(OSError):
            self._wake.send(b"x")

    def close(self) -> None:
        """Close the control sockets."""
        if not control_client.AVAILABLE:
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
                line = control_client.read_line(client, _READING)
                with self._lock:  # a request that is complete does not count among those that may be slow
                    if client in self._clients:
                        self._clients.remove(client)
                client.settimeout(_READING)
                client.sendall(json.dumps(self._answer(line, control_client.peer_of(client))).encode() + b"\n")
        except OSError:
            return
        finally:
            with self._lock:
                if client in self._clients:
                    self._clients.remove(client)

    def _answer(self, line: bytes, peer: control_client.Peer) -> dict[str, Any]:
        head = {"holder": f"{own_name()} (process {os.getpid()})"}
        try:
            asked = json.loads(line)
            do, names = asked["do"], asked.get("port")
            if isinstance(names, list) and not set(map(str, names)) & set(aliases(self._url)):
                # the number of a port that is unplugged may be another one's by now
                return head | {"error": f"this program holds {self._url}, which is another port"}
            if do == "stop":
                who = control_client.printable(asked.get("who")) or _user(peer)
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

    def _may_ask(self, peer: control_client.Peer) -> bool:
        """Return whether a process may control the port: same user, administrator, or permitted to open the port."""
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


def _user(peer: control_client.Peer) -> str:
    with suppress(ImportError, KeyError):
        import pwd

        return pwd.getpwuid(peer.uid).pw_name
    return f"user {peer.uid}" if peer.uid >= 0 else "another program"
