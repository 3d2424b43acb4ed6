"""Transport to a device that runs in a thread of the same process."""

from __future__ import annotations

import atexit
import contextvars
import signal
import socket
import sys
import threading
from contextlib import suppress

from fabry_perot.device.endpoints import PairEndpoint
from fabry_perot.device.serve import DeviceServer
from fabry_perot.errors import LinkLost, PortBusy
from fabry_perot.hardware.instrument import Instrument
from fabry_perot.wire.framing import MAX_PAYLOAD

_LIVE_DEVICES: set[int] = set()
"""Instruments that have a host, by identity."""
_LIVE_LOCK = threading.Lock()
READ_WAIT = 0.004
"""Longest wait for bytes in one read, in s."""


_OPEN: set[LocalTransport] = set()


def _stop_all_devices(*_: object) -> None:
    """Stop all devices of this process with shutters closed, then end the program as by SIGTERM."""
    for transport in _OPEN:
        transport.end()
    sys.exit(128 + signal.SIGTERM)


def _install_sigterm_handler() -> None:
    """Install a SIGTERM handler while a device exists, unless the program has its own; main thread only."""
    if threading.current_thread() is not threading.main_thread():
        return
    if _OPEN and signal.getsignal(signal.SIGTERM) == signal.SIG_DFL:
        signal.signal(signal.SIGTERM, _stop_all_devices)
    elif not _OPEN and signal.getsignal(signal.SIGTERM) is _stop_all_devices:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


class LocalTransport:
    """Transport to a device thread of this process, which ends, shutter closed, with the transport or the program.

    SIGTERM counts as an end of the program that began it in its main thread, unless that handles the signal itself.

    Parameters
    ----------
    instrument
        The hardware; from now on only the device's thread may use it.

    Raises
    ------
    PortBusy
        When it has a host already.
    """

    def __init__(self, instrument: Instrument) -> None:
        self._held = id(instrument)
        with _LIVE_LOCK:
            if self._held in _LIVE_DEVICES:
                raise PortBusy(f"{type(instrument).__name__} has a host in this process already")
            _LIVE_DEVICES.add(self._held)
        self._end, far = socket.socketpair()
        self._end.settimeout(READ_WAIT)
        self._over = threading.Event()
        _OPEN.add(self)
        try:
            _install_sigterm_handler()
            service = DeviceServer(instrument, PairEndpoint(far), ring=512, plan_points=8192, max_payload=MAX_PAYLOAD)
        except BaseException:
            with suppress(Exception):
                instrument.close()
            self._end.close()
            far.close()
            self._forget()
            raise
        context = contextvars.copy_context()  # as in the thread of the other end
        work = (service.run, self._over.is_set)
        self._thread = threading.Thread(target=context.run, args=work, name="fabry-perot-device", daemon=True)
        self._thread.start()
        atexit.register(self.close)

    def read(self) -> bytes:
        """Return received bytes; raises LinkLost."""
        try:
            data = self._end.recv(65536)
        except TimeoutError:
            return b""
        except OSError as error:
            raise LinkLost(f"the device has ended: {error}") from error
        if not data:
            raise LinkLost("the device has ended")
        return data

    def write(self, data: bytes) -> None:
        """Send all of ``data``; raises LinkLost."""
        try:
            self._end.sendall(data)
        except OSError as error:
            raise LinkLost(f"the device has ended: {error}") from error

    def end(self) -> None:
        """Request the device's thread to end."""
        self._over.set()

    def close(self) -> None:
        """Stop the device and its thread."""
        atexit.unregister(self.close)
        self.end()
        self._thread.join(10.0)
        self._end.close()
        if not self._thread.is_alive():  # a device that hangs in a call to the hardware still has it
            self._forget()

    def _forget(self) -> None:
        _LIVE_DEVICES.discard(self._held)
        _OPEN.discard(self)
        _install_sigterm_handler()
