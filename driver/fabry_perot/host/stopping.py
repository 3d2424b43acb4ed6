"""Emergency stop of a scanner by any program of the computer, whoever holds its port, and the state of a held port."""

from __future__ import annotations

import os
import queue
import select
import socket
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol, TypeVar
from urllib.parse import urlsplit

from fabry_perot.errors import LinkLost, PortBusy, PortUnavailable
from fabry_perot.host import control
from fabry_perot.host.answers import PortStatus, StopAnswer, answer, unconfirmed
from fabry_perot.host.control import Listener, Reply
from fabry_perot.host.passive import Passive
from fabry_perot.host.ports import lock_owner, program_of
from fabry_perot.host.transport import Transport, open_transport
from fabry_perot.wire.states import DeviceState

T = TypeVar("T")
_ASKING = 0.3
"""Seconds after which a holder that has not answered is taken for frozen: the port is then opened a second time."""
_TURN = 0.01
"""Longest wait for bytes of a line, in s."""
_SILENCE = 0.3
"""Seconds without a word of the device after which HELLO is said to it."""
_MARGIN = 0.25
"""Seconds beyond the timeout within which an answer is given even where the system hangs."""


def emergency_stop(url: str, *, baudrate: int | None = None, timeout: float = 1.5, who: str = "") -> StopAnswer:
    """Turn the laser of a scanner off, whichever program of this computer holds its port.

    A port that nobody holds is opened. A program that holds it through this package is asked by its control socket. If
    it does not answer, or is another program, the stop is sent beside it: through a second opening of the terminal
    (POSIX systems) or as a second client of a TCP port. ABORT is valid in every session and state.

    Parameters
    ----------
    url
        A device path or pyserial URL, as of :func:`fabry_perot.connect`.
    baudrate
        Baud rate of a UART that nobody holds; of one that is held it is not changed.
    timeout
        Longest time this takes, in s.
    who
        Name of the person, for the program that holds the port.

    Returns
    -------
    StopAnswer
        Nothing is raised for a scanner that could not be asked: then ``laser`` is ``"unconfirmed"``.
    """
    began = time.monotonic()
    answers: queue.SimpleQueue[StopAnswer] = queue.SimpleQueue()

    def work() -> None:
        try:
            answers.put(_Stop(url, baudrate, began, timeout, who).run())
        except Exception as error:
            answers.put(unconfirmed(f"{url} could not be asked: {error}", time.monotonic() - began))

    threading.Thread(target=work, name="fabry-perot-stop", daemon=True).start()
    try:
        return answers.get(timeout=timeout + _MARGIN)
    except queue.Empty:
        return unconfirmed(f"{url} could not be asked within {timeout:g} s", time.monotonic() - began)


def port_status(url: str, *, timeout: float = 1.0) -> PortStatus | None:
    """Return what the program that holds a port knows of the scanner there; ``None`` if no such program answers.

    Parameters
    ----------
    url
        A device path or pyserial URL.
    timeout
        Longest wait in s.
    """
    for listener in control.listeners(url):
        reply = control.ask(listener, timeout, do="status")
        if reply is not None and control.is_trusted(url, listener, reply):
            status = status_in(reply)
            if status is not None:
                return status
    return None


def status_in(reply: Reply) -> PortStatus | None:
    """Return the status in a holder's answer; ``None`` when it has none that is complete."""
    fields = reply.body.get("status")
    try:
        return PortStatus(**{**fields, "holder": reply.holder}) if isinstance(fields, dict) else None
    except TypeError:
        return None


def ask_to_yield(url: str) -> bool:
    """Ask the holder of a port to release it, and return whether one has."""
    replies = [control.ask(listener, 1.0, do="yield") for listener in control.listeners(url)]
    return any(reply is not None and reply.body.get("yielded") is True for reply in replies)


class _Line(Protocol):
    """A line for a stop."""

    def read(self) -> bytes: ...

    def write(self, data: bytes) -> None: ...

    def close(self) -> None: ...


class _SecondOpening:
    """A terminal that another program holds, opened beside it: its settings and its lock are left alone."""

    def __init__(self, path: str) -> None:
        self._file = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

    def read(self) -> bytes:
        """Return what has arrived."""
        select.select([self._file], [], [], _TURN)
        with suppress(BlockingIOError):
            return os.read(self._file, 4096)
        return b""

    def write(self, data: bytes) -> None:
        """Send what fits."""
        with suppress(BlockingIOError):
            os.write(self._file, data)

    def close(self) -> None:
        """Close this opening only."""
        os.close(self._file)


class _TcpLine:
    """A TCP connection to a device, perhaps beside another host's."""

    def __init__(self, url: str, timeout: float) -> None:
        parts = urlsplit(url)
        self._socket = socket.create_connection((parts.hostname or "", parts.port or 0), timeout)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(_TURN)

    def read(self) -> bytes:
        """Return what has arrived; raises LinkLost."""
        try:
            data = self._socket.recv(4096)
        except TimeoutError:
            return b""
        if not data:
            raise LinkLost("the other end closed the connection")
        return data

    def write(self, data: bytes) -> None:
        """Send all of ``data``."""
        self._socket.sendall(data)

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


class _Stop:
    """One emergency stop.

    Parameters
    ----------
    url, baudrate, timeout, who
        As of :func:`emergency_stop`.
    began
        When it began, by the monotonic clock.
    """

    def __init__(self, url: str, baudrate: int | None, began: float, timeout: float, who: str) -> None:
        self._url, self._baudrate, self._began, self._who = url, baudrate, began, who
        self._deadline = began + timeout
        self._replies: queue.SimpleQueue[StopAnswer | None] = queue.SimpleQueue()
        self._asked = 0
        self._holder = ""

    def run(self) -> StopAnswer:
        """Stop by whichever way leads to the device."""
        for listener in control.listeners(self._url):
            self._asked += 1
            threading.Thread(target=self._ask, args=(listener,), name="fabry-perot-stop", daemon=True).start()
        told = self._collect(time.monotonic() + _ASKING) if self._asked else None
        if told is not None and told.laser == "off":
            return told
        own = self._through_the_port()
        if own.laser == "off" or told is None:
            late = None if own.laser == "off" else self._collect(self._deadline)
            return late or own
        return told

    def _left(self) -> float:
        return max(0.0, self._deadline - time.monotonic())

    def _passed(self) -> float:
        return time.monotonic() - self._began

    def _ask(self, listener: Listener) -> None:
        """Have one holder stop, and note its answer if it is the holder's own."""
        left = self._left()
        reply = control.ask(listener, left, do="stop", who=self._who, seconds=max(0.1, left - 0.05))
        if reply is None or not control.is_trusted(self._url, listener, reply):
            self._replies.put(None)
            return
        self._holder = reply.holder
        body = {name: reply.body.get(name) for name in ("laser", "state", "shutter", "detail")}
        known = body["laser"] in ("off", "unconfirmed") and body["shutter"] in ("open", "closed", "unknown")
        if not known or not isinstance(body["state"], str) or not isinstance(body["detail"], str):
            self._replies.put(None)
            return
        self._replies.put(StopAnswer(**body, holder=reply.holder, seconds=self._passed()))  # type: ignore[arg-type]

    def _collect(self, deadline: float) -> StopAnswer | None:
        """Return a holder's answer that the laser is off, otherwise the last one that came until ``deadline``."""
        last = None
        while self._asked:
            try:
                told = self._replies.get(timeout=max(0.0, deadline - time.monotonic()))
            except queue.Empty:
                break
            self._asked -= 1
            last = told or last
            if told is not None and told.laser == "off":
                break
        return last

    def _through_the_port(self) -> StopAnswer:
        """Send the stop ourselves: through the port, or beside the program that holds it."""
        try:
            line = self._open()
        except (PortUnavailable, PortBusy, OSError, ValueError) as error:
            return unconfirmed(self._could_not(error), self._passed(), self._holder)
        try:
            return self._talk(line)
        except (LinkLost, OSError) as error:
            return unconfirmed(f"{self._url} could not be asked: {error}", self._passed(), self._holder)
        finally:
            # closing a terminal waits until what was written has left, which may take forever
            threading.Thread(target=_close, args=(line,), name="fabry-perot-close", daemon=True).start()

    def _open(self) -> _Line:
        if self._url.startswith("socket://"):
            return _TcpLine(self._url, self._left())
        try:
            return opened(self._url, self._baudrate)
        except PortBusy:
            if "://" in self._url or sys.platform == "win32":
                raise
            owner = lock_owner(self._url)
            line = _SecondOpening(self._url)
            self._holder = program_of(owner) if owner else "another program"
            return line

    def _could_not(self, error: Exception) -> str:
        holder = f", which {self._holder} holds," if self._holder else ""
        owner = lock_owner(self._url)
        if not holder and owner:
            self._holder = program_of(owner)
            holder = f", which {self._holder} holds,"
        return f"{self._url}{holder} could not be asked: {error}"

    def _talk(self, line: _Line) -> StopAnswer:
        """Send ABORT until it is acknowledged, and read what the device says afterwards."""
        passive = Passive(time.monotonic(), _SILENCE)
        passive.stop(time.monotonic())
        while self._left() and not passive.aborts.is_off:
            now = time.monotonic()
            data = passive.pull(now)
            if data:
                line.write(data)
            passive.receive(line.read(), time.monotonic())
            told = None if self._replies.empty() else self._collect(0.0)
            if told is not None and told.laser == "off":
                return told
        if passive.aborts.after is not None:
            return answer(passive.aborts.after, self._passed(), self._holder)
        return unconfirmed(f"{self._url} {self._silence(passive)}", self._passed(), self._holder)

    def _silence(self, passive: Passive) -> str:
        by = f"is held by {self._holder} and " if self._holder else ""
        if (ack := passive.aborts.acknowledgement) is not None:
            state = DeviceState(ack.state).name.lower()
            return f"{by}acknowledged the stop in state {state}, but did not say that its shutter is closed"
        if passive.failure is not None:
            return f"{by}could not be asked: {passive.failure}"
        return f"{by}could not be asked: no scanner answered within {self._passed():.1f} s"


def opened(url: str, baudrate: int | None) -> Transport:
    """Open a port; the baud rate is the default one where none is given."""
    return open_transport(url) if baudrate is None else open_transport(url, baudrate)


def _close(line: _Line) -> None:
    with suppress(OSError, LinkLost):
        line.close()


def after_yield(opener: Callable[[], T], url: str, seconds: float = 2.0) -> T:
    """Open a port, asking a program that merely watches it to give way.

    Parameters
    ----------
    opener
        Opens it; raises PortBusy while another program holds it.
    url
        The port.
    seconds
        Longest wait for the port after its holder has given way.

    Raises
    ------
    PortBusy
        Its holder does not give way.
    """
    try:
        return opener()
    except PortBusy:
        if not ask_to_yield(url):
            raise
    deadline = time.monotonic() + seconds
    while True:
        try:
            return opener()
        except PortBusy:
            if time.monotonic() > deadline:
                raise
            ask_to_yield(url)  # another watching program may have been faster
            time.sleep(0.02)
