"""Thread that monitors a port: opens, listens, releases the port on request of another program, and reopens."""

from __future__ import annotations

import contextvars
import logging
import select
import socket
import threading
from contextlib import suppress

from fabry_perot.clock import RealClock
from fabry_perot.errors import LinkLost, PortBusy, ScannerError
from fabry_perot.host import control_client
from fabry_perot.host.address import split
from fabry_perot.host.control_client import Listener
from fabry_perot.host.control_server import ControlServer
from fabry_perot.host.emergency_stop import status_in
from fabry_perot.host.port_usage import aliases, lock_owner, program_of
from fabry_perot.host.sessionless_link import Passive
from fabry_perot.host.stop_and_status_results import PortStatus, StopAnswer, in_words
from fabry_perot.host.stop_lines import opened
from fabry_perot.host.transport import Transport

log = logging.getLogger(__name__)
HEARD = 1.0
"""A scanner of which nothing was heard for longer, in s, is not connected: it says something ten times a second."""
_LOOK = 0.2
"""Longest wait for bytes, and time between two questions to another holder, in s."""
_BLIND = 0.03
"""Time between two looks at a port that has no descriptor to wait on, in s."""
_RETRY, _LONGEST_RETRY = 0.2, 2.0
"""Time between two attempts to open a port, in s: the first, and what doubling it ends at."""
_AWAY = 3.0
"""A port that was given up for another program is left alone for so many s, if that does not come."""


class MonitorThread:
    """Base class of :class:`fabry_perot.Monitor`: monitoring of a port in a daemon thread.

    Parameters
    ----------
    url
        A device path or pyserial URL.
    baudrate
        Baud rate of a UART.
    """

    def __init__(self, url: str, *, baudrate: int | None = None) -> None:
        split(url, baudrate)  # an impossible baud rate is the caller's error, not the port's
        self.url, self._baudrate = url, baudrate
        self._clock = RealClock()
        self._changed = threading.Condition()
        self._writing = threading.Lock()
        self._closing = self._yielding = False
        self._transport: Transport | None = None
        self._passive: Passive | None = None
        self._seen: tuple[PortStatus, float] | None = None
        self._holder, self._error, self._busy = "", f"{url} has not been opened yet", False
        self._wake, self._woken = socket.socketpair()
        self._woken.setblocking(False)
        self._wake.setblocking(False)
        context = contextvars.copy_context()
        self._thread = threading.Thread(target=context.run, args=(self._run,), name="fabry-perot-monitor", daemon=True)
        self._thread.start()

    def stop(self, who: str = "", timeout: float = 1.5) -> StopAnswer:
        """Turn the laser off and return the device's state afterwards."""
        raise NotImplementedError

    def port_status(self) -> PortStatus | None:
        """Return the device's last STATUS; ``None`` before the first."""
        raise NotImplementedError

    def close(self) -> None:
        """Stop the thread and release the port."""
        self._closing = True
        self._nudge()
        if threading.current_thread() is not self._thread:
            self._thread.join(10.0)

    def give_way(self) -> bool:
        """Release the port for another program, and return whether it is released."""
        with self._changed:
            if self._transport is None:
                return True
            self._yielding = True
        self._nudge()
        with self._changed:
            return self._changed.wait_for(lambda: self._transport is None, 1.0)

    def _now(self) -> float:
        return self._clock.now() * 1e-6

    def _nudge(self) -> None:
        with suppress(OSError):
            self._wake.send(b"x")

    def _heard(self) -> bool:
        passive = self._passive
        return passive is not None and passive.status is not None and self._now() - passive.status_at <= HEARD

    def _send(self) -> None:
        """Send due messages; errors of the line are handled by the reading thread."""
        with self._writing:
            with self._changed:
                transport = self._transport
                data = b"" if self._passive is None else self._passive.pull(self._now())
            if transport is not None and data:
                with suppress(LinkLost, OSError):
                    transport.write(data)

    def _run(self) -> None:
        wait = _RETRY
        while not self._closing:
            try:
                heard = self._watch()
            except (ScannerError, OSError, ValueError) as error:
                heard = False
                self._note(str(error), busy=isinstance(error, PortBusy))
            except Exception as error:
                heard = False
                log.exception("the monitor of %s continues after an error", self.url)
                self._note(f"{self.url}: {error!r}", busy=False)
            wait = _RETRY if heard else wait
            if not self._yielding:
                self._pause(wait)
            wait = min(2 * wait, _LONGEST_RETRY)
        self._wake.close()
        self._woken.close()

    def _watch(self) -> bool:
        """Monitor the port once, through its holder or directly; return whether the device was heard."""
        if self._yielding:
            self._stay_away()
        others = control_client.listeners(self.url)
        if others and self._follow(others[0]):
            return True
        self._must_be_free()
        return self._listen(opened(self.url, self._baudrate))

    def _must_be_free(self) -> None:
        """Raise PortBusy for a locked terminal without opening it, because opening may change a port's lines."""
        owner = lock_owner(self.url)
        if owner is not None:
            raise PortBusy(f"{self.url} is in use by {program_of(owner)}")

    def _note(self, error: str, *, busy: bool, holder: str = "") -> None:
        with self._changed:
            if busy and not holder:
                owner = lock_owner(self.url)
                holder = program_of(owner) if owner else "another program"
            self._error, self._busy, self._holder = error, busy, holder
            self._changed.notify_all()

    def _pause(self, seconds: float) -> None:
        """Wait for some seconds, unless the monitor is to close or release the port."""
        if not (self._closing or self._yielding):
            select.select([self._woken], [], [], seconds)
        with suppress(OSError):
            self._woken.recv(4096)

    def _stay_away(self) -> None:
        """Wait without the port after releasing it to another program."""
        until, self._yielding = self._now() + _AWAY, False
        self._note(f"{self.url} was given up for another program", busy=True)
        while self._now() < until and not self._closing:
            if control_client.listeners(self.url) or lock_owner(self.url) is not None:
                return
            self._pause(0.05)

    def _follow(self, listener: Listener) -> bool:
        """Poll the status from another holder as long as it replies; return whether it replied at all."""
        answered = False
        while not self._closing:
            reply = control_client.ask(listener, 1.0, do="status", port=aliases(self.url))
            if reply is None or "error" in reply.body or not control_client.is_trusted(self.url, listener, reply):
                return answered
            answered, status = True, status_in(reply)
            self._note("" if status else f"{reply.holder} has received nothing yet", busy=True, holder=reply.holder)
            if status is not None:
                with self._changed:
                    self._seen = status, self._now()
            self._pause(_LOOK)
        return answered

    def _listen(self, transport: Transport) -> bool:
        """Read from the open port until it is lost, or requested by another program.

        Return whether the device was received.
        """
        passive, reason, server = Passive(self._now()), f"{self.url} is not open", None
        with self._changed:
            self._transport, self._passive = transport, passive
            if "://" not in self.url:  # a terminal that could be opened is nobody else's
                self._error, self._busy, self._holder = "", False, ""
        try:
            server = ControlServer(self, self.url)
            while not (self._closing or self._yielding or isinstance(passive.failure, PortBusy)):
                self._take(transport, passive)
                self._send()
        except (LinkLost, OSError, ValueError) as error:
            reason = f"{self.url}: {error}"
        finally:
            if server is not None:
                server.close()
            with self._writing, suppress(ScannerError, OSError):
                transport.close()
            busy = isinstance(passive.failure, PortBusy)
            with self._changed:
                self._transport = self._passive = None
            self._note(str(passive.failure) if busy else reason, busy=busy, holder="another host" if busy else "")
        return passive.status is not None

    def _take(self, transport: Transport, passive: Passive) -> None:
        """Wait for bytes and process them."""
        now = self._now()
        left = min(_LOOK, passive.next_due(now))
        descriptor = getattr(transport, "descriptor", lambda: None)()
        if descriptor is None:
            self._pause(min(_BLIND, left))
        else:
            ready, _, _ = select.select([descriptor, self._woken], [], [], left)
            if self._woken in ready:
                with suppress(OSError):
                    self._woken.recv(4096)
            if descriptor not in ready:
                return
        data = transport.read()
        with self._changed:
            now = self._now()
            passive.receive(data, now)
            if passive.status is not None and passive.status_at == now:
                self._seen = in_words(passive.status, 0.0), now
                self._error, self._busy, self._holder = "", False, ""
            self._changed.notify_all()
