"""Monitor of an idle scanner: reads laser, interlock and faults without a session of its own."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from types import TracebackType
from typing import Any, Literal, Self

from fabry_perot import fault_codes
from fabry_perot.errors import FaultStands, PortBusy, RequestRejected, ResponseTimeout
from fabry_perot.host.emergency_stop import emergency_stop
from fabry_perot.host.monitor_thread import MonitorThread
from fabry_perot.host.sessionless_link import Passive
from fabry_perot.host.stop_and_status_results import FaultCleared, PortStatus, StopAnswer, answer, standing, unconfirmed
from fabry_perot.wire.constants import Operation
from fabry_perot.wire.messages import Status
from fabry_perot.wire.states import LATCHED_STATES, DeviceState

LEAST = 0.1
"""Shortest time in s for which a port is asked anew after it was given up under a stop."""
_PATIENCE = 2.0
"""Longest wait for an answer of the device, in s."""
Connection = Literal["connected", "disconnected", "busy"]


class Monitor(MonitorThread):
    """Monitor of one port, in a daemon thread, until it is closed.

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
        """The device's last STATUS, received by this program or by the port's holder; ``None`` before the first.

        Its ``age`` grows while nothing is heard.
        """
        with self._changed:
            if self._seen is None:
                return None
            status, at = self._seen
            return replace(status, age=status.age + max(0.0, self._now() - at))

    @property
    def connection(self) -> Connection:
        """Kind of connection: the device is received on this program's line, or another program holds the port."""
        with self._changed:
            if self._busy:
                return "busy"
            return "connected" if self._passive is not None and self._heard() else "disconnected"

    @property
    def error(self) -> str | None:
        """Present reason why the device's state is unknown, one sentence; ``None`` while it is known."""
        with self._changed:
            passive = self._passive
            if passive is None or self._busy:
                return self._error or None
            if self._heard():
                return None
            if passive.failure is not None:
                return f"{self.url}: {passive.failure}"
            return (
                f"{self.url} is open, but received nothing from a scanner for {self._now() - passive.status_at:.0f} s"
            )

    @property
    def holder(self) -> str:
        """Name and process of the program that holds the port; ``""`` for this monitor, or none."""
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
        if passive is not None:
            self._until(lambda: passive.aborts.is_off or self._passive is not passive, timeout, passive)
            with self._changed:
                after, seconds, gone = passive.aborts.after, self._now() - began, self._passive is not passive
            if after is not None and (passive.aborts.is_off or not gone):
                return answer(after, seconds)
            if not gone or timeout - seconds < LEAST:
                why = self.error or f"{self.url} could not be asked: the scanner did not answer"
                return unconfirmed(why, seconds)
        left = timeout - (self._now() - began)  # the port was given up, perhaps for a program that may fire
        outcome = emergency_stop(self.url, baudrate=self._baudrate, timeout=left, who=who)
        return replace(outcome, seconds=self._now() - began)

    def clear_fault(self, by: str = "") -> FaultCleared:
        """Clear a latched fault or emergency stop in a person's name; the laser stays off.

        Parameters
        ----------
        by
            Name of the person.

        Raises
        ------
        FaultStands
            The cause still stands: interlock open, key off, shutter open or light.
        RequestRejected
            Nothing is latched.
        PortBusy
            Another program holds the port.
        ResponseTimeout
            The device does not answer.
        """
        passive, status = self._present()
        if status.state not in LATCHED_STATES:
            raise RequestRejected(Operation.CLEAR_FAULT.name, "nothing is latched", DeviceState(status.state).name)
        fault = status.fault if status.state == DeviceState.FAULT else 0
        if cause := standing(status):
            raise FaultStands(fault, cause)
        with self._changed:
            request = passive.ask(Operation.CLEAR_FAULT)
        try:
            done = self._until(lambda: request.done, _PATIENCE, passive)
        finally:
            with self._changed:
                passive.withdraw(request)
        if not done:
            raise ResponseTimeout(f"{self.url}: no reply to CLEAR_FAULT within {_PATIENCE:g} s")
        passive, status = self._present()
        if request.error is not None:
            raise FaultStands(fault, standing(status)) if standing(status) else request.error
        if status.state in LATCHED_STATES:
            raise FaultStands(status.fault, standing(status) or "the device reported it again at once")
        return FaultCleared(fault_codes.by_code(fault), by, datetime.now(UTC), DeviceState(status.state).name.lower())

    def port_status(self) -> PortStatus | None:
        """Return the device's last STATUS, in reply to another program's query."""
        return self.status

    def _present(self) -> tuple[Passive, Status]:
        """Wait for a new STATUS on this program's own line; raises the reason if none arrives."""
        with self._changed:
            passive = self._passive
            if passive is None:
                raise (PortBusy if self._busy else ResponseTimeout)(self._error or f"{self.url} is not open")
            last = passive.status_at
        if not self._until(lambda: passive.status_at > last, _PATIENCE, passive) or passive.status is None:
            raise ResponseTimeout(self.error or f"{self.url}: the scanner does not answer")
        return passive, passive.status

    def _until(self, condition: Any, seconds: float, passive: Passive) -> bool:
        """Wait until a condition holds or a timeout expires, and return whether the condition holds.

        The watching thread alone writes: a write to a stuck line takes seconds.
        """
        deadline = self._now() + seconds
        self._nudge()
        while True:
            with self._changed:
                if condition():
                    return True
                if self._now() > deadline or self._passive is not passive:
                    return False
                self._changed.wait(0.02)
