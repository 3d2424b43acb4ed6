"""Session with a device: host state machine, I/O thread, and waiting for conditions."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from fabry_perot.clock import Clock, RealClock
from fabry_perot.errors import LinkLost, ResponseTimeout, ScanAborted
from fabry_perot.host import Host, HostTiming
from fabry_perot.host.control_server import ControlServer
from fabry_perot.host.handshake import new_nonce
from fabry_perot.host.io_pump import IoPump
from fabry_perot.host.link_states import HostState
from fabry_perot.host.stop_and_status_results import PortStatus, StopAnswer, answer, in_words
from fabry_perot.host.transport import Transport
from fabry_perot.wire.constants import AbortLevel, Operation

POLL_STEP = 0.05
"""Longest wait between two looks at the state, in s; also how often a waiting consumer renews the lease."""
_STOPPED_WITHIN = 2.0
"""Longest wait in s for the outcome of an emergency stop before the port is released."""
_STOP_REQUEST_WAIT = 1.0
"""Longest wait in s for the request of a stop that the device has reported already."""
_REQUEST_TIMEOUT = 15.0


class Session:
    """Session with a device: a host state machine connected to a transport by an I/O thread.

    Parameters
    ----------
    transport
        The open port; closed with the session.
    clock
        Host time.
    timing
        Time limits.
    reopen, patience
        How to open a lost port anew, and for how many seconds to try.
    port
        The port, for the control socket by which other programs can stop the laser; ``None``: no such socket.
    cancelled
        Asked until the session has come about: once it says so, ResponseTimeout is raised.

    Raises
    ------
    ResponseTimeout, ProtocolMismatch, LinkLost
        No session came about; the port is released.
    """

    def __init__(
        self,
        transport: Transport,
        clock: Clock | None = None,
        timing: HostTiming | None = None,
        reopen: Callable[[], Transport] | None = None,
        patience: float = 0.0,
        port: str | None = None,
        cancelled: Callable[[], bool] | None = None,
    ) -> None:
        self.clock, self.port = clock or RealClock(), port
        self.host = Host(new_nonce(), timing)
        self.host.traffic.baud = getattr(transport, "baudrate", None)
        self.changed = threading.Condition()
        self.stopped_by = ""
        """Name of the person whose emergency stop, sent by another program, ended the work of this session."""
        self._closed = False
        self._stops = 0
        """Emergency stops whose outcome is waited for."""
        self._control: ControlServer | None = None
        self._pump = IoPump(transport, self.host, self.clock, self.changed, self._rebinding(reopen), patience)
        try:
            if port is not None:
                self._control = ControlServer(self, port)
            self._pump.start()
            self.wait(lambda: self._is_up(cancelled), _REQUEST_TIMEOUT)
        except BaseException:
            self._release()
            raise

    def _is_up(self, cancelled: Callable[[], bool] | None) -> bool:
        if cancelled is not None and cancelled():
            raise ResponseTimeout("connecting was given up before the scanner had answered")
        return self.host.capabilities is not None and self.host.status is not None

    def _rebinding(self, reopen: Callable[[], Transport] | None) -> Callable[[], Transport] | None:
        """Update the control socket's names, which depend on the port, after a port is reopened."""
        if reopen is None:
            return None

        def again() -> Transport:
            transport = reopen()
            if (server := self._control) is not None:
                server.bind()
            return transport

        return again

    def _release(self) -> None:
        server, self._control = self._control, None  # a connection may be closed twice, by two threads
        if server is not None:
            server.close()
        self._pump.stop()

    @property
    def reconnects(self) -> int:
        """Number of times the port was reopened."""
        return self._pump.reconnects

    def now(self) -> int:
        """Return the host's time in µs."""
        return self.clock.now()

    def flush(self) -> None:
        """Send pending messages now."""
        self._pump.flush()

    def request(self, operation: Operation, *, within: float = _REQUEST_TIMEOUT, **body: Any) -> dict[str, Any]:
        """Send a request and return its reply within ``within`` s; raises the error of device or link."""

        def start(now: int) -> Any:
            if operation in (Operation.ARM, Operation.START):
                self.must_not_be_stopped()
            return self.host.call(operation, now, **body)

        return self.call(start, within)

    def call(self, start: Callable[[int], Any], within: float = _REQUEST_TIMEOUT) -> dict[str, Any]:
        """Start a request by ``start(now)`` and return its reply, at most ``within`` s later."""
        with self.changed:
            call = start(self.now())
        self.flush()
        self.wait(lambda: call.done, within, raise_failure=False)
        answer: dict[str, Any] = call.result()
        return answer

    def wait(
        self,
        ready: Callable[[], bool],
        timeout: float,
        *,
        raise_failure: bool = True,
        progress: Callable[[], object] = lambda: None,
    ) -> None:
        """Wait until ``ready()`` is true, at most ``timeout`` s after ``progress()`` last changed.

        Raises
        ------
        ResponseTimeout
            The time is over.
        LinkError, DeviceError
            The host has failed, or the connection was closed.
        """
        with self.changed:
            since, moved = self.host.traffic.mark(self.now()), progress()
            deadline = since.time + int(timeout * 1e6)
            while not ready():
                if progress() != moved:
                    moved, deadline = progress(), self.now() + int(timeout * 1e6)
                if raise_failure and self.host.failure is not None:
                    raise self.host.failure
                if self._closed:
                    raise LinkLost("the connection was closed")
                if self.now() > deadline:
                    why = self.host.traffic.explain(since, self.now())
                    raise ResponseTimeout(f"the scanner did not get there within {timeout:g} s: {why}")
                self.changed.wait(POLL_STEP)

    def close(self) -> None:
        """Stop the thread and release the port, after any emergency stop in progress; waiting callers are notified."""
        with self.changed:
            self.changed.wait_for(lambda: not self._stops, _STOPPED_WITHIN)
            self._closed = True
            self.changed.notify_all()
        self._release()

    def must_not_be_stopped(self) -> None:
        """Raise ScanAborted if another program has stopped the laser; :attr:`changed` must be held."""
        if self.stopped_by:
            raise ScanAborted(f"stopped by an emergency stop from {self.stopped_by}; plan and data are kept")

    def wait_for_stop_request(self) -> None:
        """Wait briefly for the request of a stop that another program sent to the device itself.

        That program does so where this one has not answered within 0.1 s, and the device may report the stop before
        the request, which has the person's name, is read. :attr:`changed` must be held.
        """
        if self._control is not None:
            self.changed.wait_for(lambda: self.stopped_by or self._closed, _STOP_REQUEST_WAIT)

    def stop(self, who: str, timeout: float) -> StopAnswer:
        """Turn the laser off for another program, and end this session's operations.

        Parameters
        ----------
        who
            Name of the person, for the error that the application gets.
        timeout
            Longest wait in s for what the device says.
        """
        began = self.now()
        with self.changed:
            self.stopped_by = who
            self._stops += 1
        try:
            return self._stop(began, timeout)
        finally:
            with self.changed:
                self._stops -= 1
                self.changed.notify_all()

    def _stop(self, began: int, timeout: float) -> StopAnswer:
        with self.changed:
            self.host.abort(AbortLevel.LASER_OFF, began)
            number = self.host.aborts.number
        threading.Thread(target=self.flush, name="fabry-perot-stop", daemon=True).start()  # a stuck write takes 5 s
        deadline = began + int(timeout * 1e6)
        with self.changed:
            aborts = self.host.aborts
            while not (aborts.answered(number) and aborts.is_off) and self.now() < deadline and not self._closed:
                self.changed.wait(POLL_STEP)
                if not aborts.pending and not aborts.answered(number):  # the device has restarted meanwhile
                    self.host.abort(AbortLevel.LASER_OFF, self.now())
            trouble = "" if aborts.answered(number) else self._trouble()
            return answer(aborts.after, (self.now() - began) * 1e-6, trouble=trouble)

    def _trouble(self) -> str:
        """Return the reason why the device has not acknowledged a stop."""
        if self.host.failure is not None:
            return str(self.host.failure)
        if self.host.phase is HostState.LOST:
            return "the port is gone"
        return "the scanner does not answer"

    def port_status(self) -> PortStatus | None:
        """Return the device's last STATUS, in reply to another program's query."""
        with self.changed:
            status = self.host.status
            if status is None:
                return None
            return in_words(status, self.host.time_since_heard(self.now()) * 1e-6)

    def give_way(self) -> bool:
        """Reject another program's request to release the port, because this session is in use."""
        return False
