"""The thread between port and host state machine, and why a stream of A-lines stops."""

from __future__ import annotations

import threading

from fabry_perot.clock import Clock
from fabry_perot.errors import (
    DeviceFault,
    EmergencyStopped,
    LeaseLapsed,
    LinkLost,
    ScanAborted,
    ScannerError,
)
from fabry_perot.host import Host
from fabry_perot.states import DeviceState, HoldCause
from fabry_perot.transport import Transport


class Pump:
    """Moves bytes between a transport and a host in one background thread.

    Parameters
    ----------
    transport, host, clock
        What it connects.
    changed
        Guards the host; notified whenever bytes were taken in.
    """

    def __init__(self, transport: Transport, host: Host, clock: Clock, changed: threading.Condition) -> None:
        self._transport, self._host, self._clock, self._changed = transport, host, clock, changed
        self._writing = threading.Lock()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="fabry-perot-io", daemon=True)

    def start(self) -> None:
        """Open the host and start the thread."""
        with self._changed:
            self._host.open(self._clock.now())
        self._thread.start()

    def stop(self) -> None:
        """End the thread and close the port."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join(10.0)
        self._transport.close()

    def flush(self) -> None:
        """Send what the host has to say now, from the calling thread."""
        with self._writing:
            with self._changed:
                data = self._host.pull()
            if not data:
                return
            try:
                self._transport.write(data)
            except LinkLost as error:
                self._fail(error)

    def _fail(self, error: ScannerError) -> None:
        with self._changed:
            self._host.fail(error)
            self._changed.notify_all()

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                data = self._transport.read()
            except LinkLost as error:
                self._fail(error)
                return
            with self._changed:
                now = self._clock.now()
                if data:
                    self._host.receive(data, now)
                    self._changed.notify_all()
                else:
                    self._host.poll(now)
            self.flush()


def stop_reason(host: Host, now: int) -> ScannerError | None:
    """Return why no more A-lines will come by themselves, or ``None`` while they may.

    A-lines the device still holds come first, also when the laser is off already.
    """
    if host.failure is not None:
        return host.failure
    status, assembly = host.status, host.assembly
    if host.silent_for(now) > host.timing.patience:
        return LinkLost("the scanner has gone silent")
    if status is None or assembly is None or status.state != host.device_state:
        return None
    if status.plan == assembly.plan and assembly.delivered < status.produced:
        return None
    if host.device_state is DeviceState.FAULT:
        return DeviceFault(f"the scanner reports fault {status.fault}")
    if host.device_state is DeviceState.ESTOP:
        return EmergencyStopped("the emergency stop is latched")
    if host.device_state in (DeviceState.SAFE_HOLD, DeviceState.READY, DeviceState.LINKED):
        if status.cause in (HoldCause.LEASE, HoldCause.SESSION):
            return LeaseLapsed("the laser lease lapsed: the laser is off, plan and data are kept")
        return ScanAborted(f"the scan was stopped (state {host.device_state.name.lower()})")
    return None
