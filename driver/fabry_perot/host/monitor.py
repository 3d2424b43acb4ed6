"""Monitor of a scanner: holds a port without a session of its own, and knows laser, interlock and faults meanwhile."""

from __future__ import annotations

import contextvars
import select
import socket
import threading
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from types import TracebackType
from typing import Any, Literal, Self

from fabry_perot import faults
from fabry_perot.clock import RealClock
from fabry_perot.errors import FaultStands, LinkLost, NoAnswer, PortBusy, PortUnavailable, Refused, ScannerError
from fabry_perot.host import control
from fabry_perot.host.answers import FaultCleared, PortStatus, StopAnswer, answer, in_words, standing, unconfirmed
from fabry_perot.host.control import ControlServer, Listener
from fabry_perot.host.passive import Passive
from fabry_perot.host.ports import lock_owner, program_of
from fabry_perot.host.stopping import emergency_stop, opened, status_in
from fabry_perot.host.transport import Transport
from fabry_perot.wire.codes import Operation
from fabry_perot.wire.messages import Status
from fabry_perot.wire.states import LATCHED, DeviceState

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
_PATIENCE = 2.0
"""Longest wait for an answer of the device, in s."""
Connection = Literal["connected", "disconnected", "busy"]


class Monitor:
    """Watcher of one port, in a daemon thread, until it is closed.

    It listens to the STATUS messages that the device sends ten times a second and says nothing itself, but HELLO to a
    device that is silent. A port that is gone is opened again when it is back. Another program that connects
    (:func:`fabry_perot.connect`) gets the port at once; its control socket is then asked for the device's state, and
    the port is opened again when that program has ended. Methods may be called from any thread.

    Parameters
    ----------
    url
        A device path or pyserial URL, as of :func:`fabry_perot.connect`.
    baudrate
        Baud rate of a UART.
    """

    def __init__(self, url: str, *, baudrate: int | None = None) -> None:
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
        context = contextvars.copy_context()
        self._thread = threading.Thread(target=context.run, args=(self._run,), name="fabry-perot-monitor", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Monitor: {self.url}, {self.connection}>"

    @property
    def status(self) -> PortStatus | None:
        """The device's last STATUS, by this program or by the one that holds the port; ``None`` before the first.

        Its ``age`` grows while nothing is heard.
        """
        with self._changed:
            if self._seen is None:
                return None
            status, at = self._seen
            return replace(status, age=status.age + max(0.0, self._now() - at))

    @property
    def connection(self) -> Connection:
        """Whether the device is heard on this program's own line, or another program has the port."""
        with self._changed:
            if self._busy:
                return "busy"
            return "connected" if self._passive is not None and self._heard() else "disconnected"

    @property
    def error(self) -> str | None:
        """Present reason why the state of the device is not known, one sentence; ``None`` while it is."""
        with self._changed:
            passive = self._passive
            if passive is None:
                return self._error or None
            if self._heard():
                return None
            if passive.failure is not None:
                return f"{self.url}: {passive.failure}"
            return f"{self.url} is open, but no scanner has been heard for {self._now() - passive.status_at:.0f} s"

    @property
    def holder(self) -> str:
        """Program and process that holds the port; ``""`` if it is this monitor, or none."""
        with self._changed:
            return self._holder

    def stop(self, who: str = "", timeout: float = 1.5) -> StopAnswer:
        """Turn the laser off, whichever program holds the port.

        Parameters
        ----------
        who
            Name of the person.
        timeout
            Longest time this takes, in s.
        """
        began = self._now()
        with self._changed:
            passive = self._passive
            if passive is not None:
                passive.stop(began)
        if passive is None:
            return emergency_stop(self.url, baudrate=self._baudrate, timeout=timeout, who=who)
        self._until(lambda: passive.aborts.is_off or self._passive is not passive, timeout, passive)
        with self._changed:
            after, seconds = passive.aborts.after, self._now() - began
        if after is None:
            why = self.error or f"{self.url} could not be asked: the scanner did not answer"
            return unconfirmed(why, seconds)
        return answer(after, seconds)

    def clear_fault(self, by: str = "") -> FaultCleared:
        """Clear a latched fault or emergency stop: a person's deed; the laser stays off.

        Parameters
        ----------
        by
            Name of the person.

        Raises
        ------
        FaultStands
            The cause still stands: interlock open, key off, shutter open or light.
        Refused
            Nothing is latched.
        PortBusy
            Another program holds the port.
        NoAnswer
            The device does not answer.
        """
        passive, status = self._present()
        if status.state not in LATCHED:
            raise Refused(Operation.CLEAR_FAULT.name, "wrong-state", DeviceState(status.state).name)
        fault = status.fault if status.state == DeviceState.FAULT else 0
        if cause := standing(status):
            raise FaultStands(fault, cause)
        with self._changed:
            request = passive.ask(Operation.CLEAR_FAULT)
        if not self._until(lambda: request.done, _PATIENCE, passive):
            raise NoAnswer(f"{self.url}: no reply to CLEAR_FAULT within {_PATIENCE:g} s")
        passive, status = self._present()
        if request.error is not None:
            raise FaultStands(fault, standing(status)) if standing(status) else request.error
        if status.state in LATCHED:
            raise FaultStands(status.fault, standing(status) or "the device reported it again at once")
        return FaultCleared(faults.by_code(fault), by, datetime.now(UTC), DeviceState(status.state).name.lower())

    def close(self) -> None:
        """Release the port and end."""
        self._closing = True
        self._nudge()
        if threading.current_thread() is not self._thread:
            self._thread.join(10.0)

    def port_status(self) -> PortStatus | None:
        """Return the device's last STATUS, for another program."""
        return self.status

    def give_way(self) -> bool:
        """Release the port for another program, and return whether it is released."""
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

    def _present(self) -> tuple[Passive, Status]:
        """Wait for a new STATUS on this program's own line; raises why there is none."""
        with self._changed:
            passive = self._passive
            if passive is None:
                raise (PortBusy if self._busy else NoAnswer)(self._error or f"{self.url} is not open")
            last = passive.status_at
        if not self._until(lambda: passive.status_at > last, _PATIENCE, passive) or passive.status is None:
            raise NoAnswer(self.error or f"{self.url}: the scanner does not answer")
        return passive, passive.status

    def _until(self, condition: Any, seconds: float, passive: Passive) -> bool:
        """Send what is due until a condition holds, at most for so long, and return whether it does."""
        deadline = self._now() + seconds
        while True:
            self._send()
            with self._changed:
                if condition():
                    return True
                if self._now() > deadline or self._passive is not passive:
                    return False
                self._changed.wait(0.02)

    def _send(self) -> None:
        """Send what is due; what goes wrong with the line is for the thread that reads it."""
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
            if self._yielding:
                self._stay_away()
            others = control.listeners(self.url)
            if others and self._follow(others[0]):
                continue
            try:
                self._must_be_free()
                transport = opened(self.url, self._baudrate)
            except (PortBusy, PortUnavailable, OSError, ValueError) as error:
                self._note(str(error), busy=isinstance(error, PortBusy))
            else:
                wait = _RETRY
                self._listen(transport)
                if self._yielding:
                    continue
            self._pause(wait)
            wait = min(2 * wait, _LONGEST_RETRY)
        self._wake.close()
        self._woken.close()

    def _must_be_free(self) -> None:
        """Raise PortBusy for a locked terminal, without opening it: that alone may change a port's lines."""
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
        """Wait, but not for a monitor that is to close or give way."""
        if not (self._closing or self._yielding):
            select.select([self._woken], [], [], seconds)
        with suppress(OSError):
            self._woken.recv(4096)

    def _stay_away(self) -> None:
        """Leave the port to the program that asked for it."""
        until, self._yielding = self._now() + _AWAY, False
        self._note(f"{self.url} was given up for another program", busy=True)
        while self._now() < until and not self._closing:
            if control.listeners(self.url) or lock_owner(self.url) is not None:
                return
            self._pause(0.05)

    def _follow(self, listener: Listener) -> bool:
        """Show what another holder says as long as it answers, and return whether it did at all."""
        answered = False
        while not self._closing:
            reply = control.ask(listener, 1.0, do="status")
            if reply is None or not control.is_trusted(self.url, listener, reply):
                return answered
            answered, status = True, status_in(reply)
            self._note("" if status else f"{reply.holder} has heard nothing yet", busy=True, holder=reply.holder)
            if status is not None:
                with self._changed:
                    self._seen = status, self._now()
            self._pause(_LOOK)
        return answered

    def _listen(self, transport: Transport) -> None:
        """Hold an open port until it is gone, or wanted by another program."""
        with self._changed:
            self._transport, self._passive = transport, Passive(self._now())
            self._error, self._busy, self._holder = "", False, ""
        server = ControlServer(self, self.url)
        reason = ""
        try:
            while not (self._closing or self._yielding):
                self._take(transport)
                if isinstance(self._passive.failure, PortBusy):
                    reason = f"{self.url}: {self._passive.failure}"
                    break
                self._send()
        except (LinkLost, OSError) as error:
            reason = f"{self.url}: {error}"
        server.close()
        busy = isinstance(self._passive.failure, PortBusy)
        with self._writing, suppress(ScannerError, OSError):
            transport.close()
        with self._changed:
            self._transport = self._passive = None
        self._note(reason or f"{self.url} is not open", busy=busy, holder="another host" if busy else "")

    def _take(self, transport: Transport) -> None:
        """Wait for bytes and take them in."""
        passive = self._passive
        if passive is None:
            return
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
            self._changed.notify_all()
