"""Emergency stop by any program of the computer, and status query of a port that another program holds."""

from __future__ import annotations

import queue
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar

from fabry_perot.errors import LinkLost, PortBusy, ScannerError
from fabry_perot.host import control_client
from fabry_perot.host.address import split
from fabry_perot.host.control_client import Listener, Reply
from fabry_perot.host.port_usage import aliases, lock_owner, program_of
from fabry_perot.host.sessionless_link import Passive
from fabry_perot.host.stop_and_status_results import PortStatus, StopAnswer, answer, unconfirmed
from fabry_perot.host.stop_lines import TURN, SecondConnection, TcpLine, opened
from fabry_perot.host.transport import Transport
from fabry_perot.wire.states import DeviceState

T = TypeVar("T")
_ASKING = 0.1
"""Seconds after which the stop is also sent beside a holder that has not answered yet."""
_FROZEN = 0.4
"""Seconds after which such a holder is taken for frozen, and the bytes that were meant for it are read."""
_SILENCE, _SILENCE_BESIDE = 0.3, 0.7
"""Seconds without a word of the device after which HELLO is said to it; the latter beside a program that holds it."""
_CLOSING = 0.2
"""Longest wait in s for a line to be closed before the answer is given."""
_STARTING = 1.0
"""Longest wait in s for the control socket of a program that has locked a terminal."""
_MARGIN = 0.3
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
    """Return the scanner status known to the program that holds a port; ``None`` if no program replies.

    Parameters
    ----------
    url
        A device path or pyserial URL.
    timeout
        Longest wait in s.
    """
    for listener in control_client.listeners(url):
        reply = control_client.ask(listener, timeout, do="status", port=aliases(url))
        if reply is not None and control_client.is_trusted(url, listener, reply):
            status = status_in(reply)
            if status is not None:
                return status
    return None


def status_in(reply: Reply) -> PortStatus | None:
    """Return the status in a holder's reply; ``None`` if it is missing or incomplete."""
    fields = reply.body.get("status")
    try:
        return PortStatus(**{**fields, "holder": reply.holder}) if isinstance(fields, dict) else None
    except TypeError:
        return None


def ask_to_yield(url: str) -> bool | None:
    """Request the holder of a port to release it; return whether a holder did, and ``None`` if none replied."""
    replies = [
        control_client.ask(listener, 1.0, do="yield", port=aliases(url)) for listener in control_client.listeners(url)
    ]
    told = [reply.body.get("yielded") is True for reply in replies if reply is not None]
    return any(told) if told else None


class _Stop:
    """Execution of one emergency stop.

    Parameters
    ----------
    url, baudrate, timeout, who
        As of :func:`emergency_stop`.
    began
        When it began, by the monotonic clock.
    """

    def __init__(self, url: str, baudrate: int | None, began: float, timeout: float, who: str) -> None:
        self._url, self._baudrate = split(url, baudrate)
        self._began, self._who = began, who
        self._deadline = began + timeout
        self._replies: queue.SimpleQueue[StopAnswer | None] = queue.SimpleQueue()
        self._asked = 0
        self._told: StopAnswer | None = None
        self._holder = ""

    def run(self) -> StopAnswer:
        """Stop the laser by the first way that reaches the device, and return the outcome."""
        for listener in control_client.listeners(self._url):
            self._asked += 1
            threading.Thread(target=self._ask, args=(listener,), name="fabry-perot-stop", daemon=True).start()
        if self._told_off(time.monotonic() + _ASKING) and self._told is not None:
            return self._told
        own = self._through_the_port()
        if own.laser == "off":
            return own
        self._told_off(self._deadline)
        return self._told or own

    def _left(self) -> float:
        return max(0.0, self._deadline - time.monotonic())

    def _passed(self) -> float:
        return time.monotonic() - self._began

    def _ask(self, listener: Listener) -> None:
        """Request a stop from one holder, and record its reply if it is authentic."""
        left = self._left()
        request = {"do": "stop", "who": self._who, "seconds": max(0.1, left - 0.05), "port": aliases(self._url)}
        reply = control_client.ask(listener, left, **request)
        if reply is None or not control_client.is_trusted(self._url, listener, reply):
            self._replies.put(None)
            return
        self._holder = reply.holder
        body = {name: reply.body.get(name) for name in ("laser", "state", "shutter", "detail")}
        known = body["laser"] in ("off", "unconfirmed") and body["shutter"] in ("open", "closed", "unknown")
        if not known or not isinstance(body["state"], str) or not isinstance(body["detail"], str):
            self._replies.put(None)
            return
        self._replies.put(StopAnswer(**body, holder=reply.holder, seconds=self._passed()))  # type: ignore[arg-type]

    def _told_off(self, deadline: float) -> bool:
        """Wait for the holders' replies until ``deadline``; return whether a reply reports the laser off."""
        while self._asked and not (self._told is not None and self._told.laser == "off"):
            try:
                told = self._replies.get(timeout=max(0.0, deadline - time.monotonic()))
            except queue.Empty:
                break
            self._asked -= 1
            self._told = told or self._told
        return self._told is not None and self._told.laser == "off"

    def _through_the_port(self) -> StopAnswer:
        """Send the stop directly: through the port, or in parallel to the program that holds it."""
        try:
            line = self._open()
        except (ScannerError, OSError, ValueError) as error:
            return unconfirmed(self._could_not(error), self._passed(), self._holder)
        try:
            return self._talk(line)
        except (ScannerError, OSError) as error:
            return unconfirmed(f"{self._url} could not be asked: {error}", self._passed(), self._holder)
        finally:
            # closing a terminal waits until what was written has left, which may take forever
            closing = threading.Thread(target=_close, args=(line,), name="fabry-perot-close", daemon=True)
            closing.start()
            closing.join(_CLOSING)

    def _open(self) -> Transport:
        if self._url.startswith("socket://"):
            return TcpLine(self._url, self._left())
        owner = lock_owner(self._url)
        if not owner:
            try:
                return opened(self._url, self._baudrate)
            except PortBusy:
                if "://" in self._url or sys.platform == "win32":
                    raise
        line = SecondConnection(self._url)
        self._holder = program_of(owner) if owner else "another program"
        return line

    def _could_not(self, error: Exception) -> str:
        holder = f", which {self._holder} holds," if self._holder else ""
        owner = lock_owner(self._url)
        if not holder and owner:
            self._holder = program_of(owner)
            holder = f", which {self._holder} holds,"
        return f"{self._url}{holder} could not be asked: {error}"

    def _talk(self, line: Transport) -> StopAnswer:
        """Send ABORT until it is acknowledged, and read the device's state afterwards."""
        beside = isinstance(line, SecondConnection)
        passive = Passive(time.monotonic(), _SILENCE_BESIDE if beside else _SILENCE)
        passive.stop(time.monotonic())
        while self._left() and not passive.aborts.is_off:
            now = time.monotonic()
            data = passive.pull(now)
            if data:
                line.write(data)
            waiting = self._asked and beside and self._passed() < _FROZEN
            if self._told_off(now + TURN if waiting else 0.0) and self._told is not None:
                return self._told
            if not waiting:
                passive.receive(line.read(), time.monotonic())
        if passive.aborts.after is not None:
            return answer(passive.aborts.after, self._passed(), self._holder)
        return unconfirmed(f"{self._url} {self._silence(passive)}", self._passed(), self._holder)

    def _silence(self, passive: Passive) -> str:
        by = f"is held by {self._holder} and " if self._holder else ""
        if (ack := passive.aborts.acknowledgement) is not None:
            state = DeviceState(ack.state).name.lower()
            return f"{by}acknowledged the stop in state {state}, but did not report a closed shutter"
        if passive.failure is not None:
            return f"{by}could not be asked: {passive.failure}"
        return f"{by}could not be asked: no scanner answered within {self._passed():.1f} s"


def _close(line: Transport) -> None:
    with suppress(OSError, LinkLost):
        line.close()


def after_yield(opener: Callable[[], T], url: str, seconds: float = 2.0) -> T:
    """Open a port; if its holder is only a monitor, request the port's release first.

    A holder without a control socket may have opened the terminal a moment ago: it is asked again for a second.

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
    began, given = time.monotonic(), False
    while True:
        try:
            return opener()
        except PortBusy:
            told = ask_to_yield(url)  # again after it was given: another monitor may have been faster
            given = given or told is True
            starts = told is None and "://" not in url  # locked just now: its control socket is yet to come
            patience = seconds if given else _STARTING if starts else 0.0
            if time.monotonic() - began >= patience:
                raise
            time.sleep(0.02)
