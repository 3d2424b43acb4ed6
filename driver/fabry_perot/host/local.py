"""A scanner without a line: the device runs in a thread of this process, and everything else is as ever."""

from __future__ import annotations

import atexit
import socket
import threading

from fabry_perot.device.endpoints import PairEndpoint
from fabry_perot.device.serving import Service
from fabry_perot.errors import LinkLost, PortBusy
from fabry_perot.hardware.instrument import Instrument
from fabry_perot.wire.framing import MAX_PAYLOAD

_HELD: set[int] = set()
"""Instruments that have a host, by identity."""
_HOLDING = threading.Lock()
READ_WAIT = 0.004
"""Longest wait for bytes in one read, in s."""


class LocalTransport:
    """Bytes to and from a device of this process, which ends with the transport or the program, its shutter closed.

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
        with _HOLDING:
            if self._held in _HELD:
                raise PortBusy(f"{type(instrument).__name__} has a host in this process already")
            _HELD.add(self._held)
        self._end, far = socket.socketpair()
        self._end.settimeout(READ_WAIT)
        self._over = threading.Event()
        try:
            service = Service(instrument, PairEndpoint(far), ring=512, plan_points=8192, max_payload=MAX_PAYLOAD)
        except BaseException:
            self._end.close()
            far.close()
            _HELD.discard(self._held)
            raise
        self._thread = threading.Thread(
            target=service.run, args=(self._over.is_set,), name="fabry-perot-device", daemon=True
        )
        self._thread.start()
        atexit.register(self.close)

    def read(self) -> bytes:
        """Return what has arrived; raises LinkLost."""
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

    def close(self) -> None:
        """End the device."""
        atexit.unregister(self.close)
        self._over.set()
        self._thread.join(10.0)
        self._end.close()
        if not self._thread.is_alive():  # a device that hangs in a call to the hardware still has it
            _HELD.discard(self._held)
