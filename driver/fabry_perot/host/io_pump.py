"""Background thread that moves bytes between transport and host."""

from __future__ import annotations

import contextvars
import logging
import threading
from collections.abc import Callable

from fabry_perot import fault_codes
from fabry_perot.clock import Clock
from fabry_perot.errors import (
    DeviceFault,
    DeviceRestarted,
    EmergencyStopped,
    LeaseExpired,
    LinkError,
    LinkLost,
    PortBusy,
    PortUnavailable,
    ScanAborted,
    ScannerError,
)
from fabry_perot.host import Host
from fabry_perot.host.handshake import new_nonce
from fabry_perot.host.link_states import HostState
from fabry_perot.host.silence_log import SilenceLog
from fabry_perot.host.traffic import Mark
from fabry_perot.host.transport import Transport
from fabry_perot.wire.states import DeviceState, HoldCause

_log = logging.getLogger(__name__)
INITIAL_BACKOFF, LONGEST_WAIT = 0.05, 1.0
"""Seconds between attempts to open a lost port anew: the first wait, and what doubling it ends at."""


class IoPump:
    """I/O thread that moves bytes between a transport and a host, and reopens a lost port.

    Parameters
    ----------
    transport, host, clock
        What it connects.
    changed
        Guards the host; notified whenever bytes were taken in.
    reopen
        Opens the port again; ``None``: a lost port is the end.
    patience
        Seconds for which that is tried.
    """

    def __init__(
        self,
        transport: Transport,
        host: Host,
        clock: Clock,
        changed: threading.Condition,
        reopen: Callable[[], Transport] | None = None,
        patience: float = 0.0,
    ) -> None:
        self._transport, self._host, self._clock, self._changed = transport, host, clock, changed
        self._reopen, self._patience = reopen, patience
        self.reconnects = 0
        self._writing = threading.Lock()
        self._stopping = threading.Event()
        self._broken: LinkLost | None = None
        self._silences = SilenceLog()
        self._known = (0, 0)
        context = contextvars.copy_context()  # so that a filter of the caller's logs knows whose lines these are
        self._thread = threading.Thread(target=context.run, args=(self._run,), name="fabry-perot-io", daemon=True)

    def start(self) -> None:
        """Start the host's handshake and the I/O thread."""
        with self._changed:
            self._host.open(self._clock.now())
        self._thread.start()

    def stop(self) -> None:
        """Stop the I/O thread and close the port."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join(10.0)
        self._transport.close()

    def flush(self) -> None:
        """Send pending messages now, from the calling thread."""
        with self._writing:
            with self._changed:
                data = self._host.take_output()
            if not data or self._broken:
                return
            try:
                self._transport.write(data)
            except LinkLost as error:
                self._broken = error  # the reading thread sees to it

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                if self._broken:
                    raise self._broken
                data = self._transport.read()
            except LinkLost as error:
                if not self._replug(error):
                    return
                continue
            with self._changed:
                now = self._clock.now()
                if data:
                    self._host.receive(data, now)
                    self._note_session()
                    self._changed.notify_all()
                else:
                    self._host.tick(now)
                self._note_silence(now)
            self.flush()

    def _note_session(self) -> None:
        """Log each new session, with the numbers by which device and line monitors identify it."""
        hello = self._host.hello
        if hello is not None and (hello.boot, hello.session) != self._known:
            self._known = hello.boot, hello.session
            _log.info("session %04x with the scanner begins, which has booted as %08x", hello.session, hello.boot)

    def _note_silence(self, now: int) -> None:
        """Log silences of the scanner, once a session has begun."""
        if self._host.hello is not None:
            self._silences.note(now, self._host.heard_at, self._host.timing.silence)

    def _replug(self, error: LinkError) -> bool:
        """Try to reopen a lost port at growing intervals; return whether it was reopened."""
        with self._changed:
            if self._host.hello is None:
                heard = self._host.deframer.counters.bytes_in
                why = self._host.traffic.explain(Mark(0, 0, 0, 0), self._clock.now()).partition(" (")[0]
                other = why if heard else "another host may be connected"
                error = PortUnavailable(f"{error}, before a scanner answered; {other}")
                self._host.fail(error)
                self._changed.notify_all()
                return False
            self._host.link_lost()
            self._changed.notify_all()
        self._transport.close()
        gone = self._clock.now()
        deadline, wait = gone + int(self._patience * 1e6), INITIAL_BACKOFF
        _log.warning("the port is gone (%s); trying for %g s to open it again", error, self._patience)
        while self._reopen is not None and self._clock.now() < deadline and not self._stopping.wait(wait):
            wait = min(2 * wait, LONGEST_WAIT)
            try:
                transport = self._reopen()
            except (PortUnavailable, PortBusy):
                continue
            with self._writing:
                self._transport, self._broken = transport, None
            with self._changed:
                self.reconnects += 1
                self._host.reopen(new_nonce(), self._clock.now())
            _log.warning("the port is open again after %.1f s", (self._clock.now() - gone) * 1e-6)
            return True
        with self._changed:
            self._host.fail(error)
            self._changed.notify_all()
        return False


def stream_end_reason(host: Host, now: int, patience: int, port: str = "PORT") -> ScannerError | None:
    """Return the reason why no further A-lines arrive without a resume, or ``None`` while they may.

    ``patience`` is for how many µs a silent line is waited for, ``port`` the port in what a fault's error advises.

    A-lines the device still holds come first, also when the laser is off already.
    """
    if host.failure is not None:
        return host.failure
    status, assembly = host.status, host.assembly
    if host.time_since_heard(now) > patience:
        return LinkLost("the scanner has gone silent")
    if status is None or assembly is None or host.phase in (HostState.LOST, HostState.HELLO):
        return None  # the device's state is not known at present
    if status.state != host.device_state:
        return None
    if status.plan == assembly.plan and assembly.delivered < status.produced:
        return None
    if status.plan != assembly.plan and host.last_words is not None:
        return DeviceRestarted()
    if host.device_state is DeviceState.FAULT:
        return DeviceFault(status.fault, port)
    if host.device_state is DeviceState.ESTOP:
        return EmergencyStopped(fault_codes.advice(0, port))
    if host.device_state in (DeviceState.SAFE_HOLD, DeviceState.READY, DeviceState.LINKED):
        if status.cause in (HoldCause.LEASE, HoldCause.SESSION):
            return LeaseExpired("the laser lease lapsed: the laser is off, plan and data are kept")
        if status.cause == HoldCause.INTERLOCK:
            return ScanAborted("the interlock was opened: the laser stays off, plan and data are kept")
        return ScanAborted(f"the scan was stopped (state {host.device_state.name.lower()})")
    return None
