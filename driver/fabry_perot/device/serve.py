"""Event loop that serves an instrument on a port."""

from __future__ import annotations

import secrets
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from fabry_perot.clock import RealClock
from fabry_perot.device.device import Device
from fabry_perot.device.endpoints import CHUNK, Endpoint, SerialEndpoint
from fabry_perot.device.tcp import TcpEndpoint
from fabry_perot.hardware.instrument import Instrument
from fabry_perot.wire.framing import MAX_PAYLOAD, UART_PAYLOAD

MAX_FRAME_BYTES = 16384
"""Bytes taken from the device at a time."""
IDLE_INTERVAL = 0.02
"""Longest wait, in s: interlock and key are looked at at least as often."""
BLIND_INTERVAL = 0.001
"""Wait of a line that cannot tell that bytes have come, in s."""


class DeviceServer:
    """Event loop of one device on one line; all calls to the instrument come from the loop's thread.

    Parameters
    ----------
    instrument, endpoint
        What to serve where.
    ring, plan_points, max_payload
        As of :class:`~fabry_perot.device.Device`.
    """

    def __init__(
        self, instrument: Instrument, endpoint: Endpoint, *, ring: int, plan_points: int, max_payload: int
    ) -> None:
        self._clock, self._endpoint, self._instrument = RealClock(), endpoint, instrument
        self._start = self._clock.now()
        self._out = b""
        boot = 1 + secrets.randbelow(0xFFFFFFFE)
        self.device = Device(instrument, boot=boot, ring=ring, plan_points=plan_points, max_payload=max_payload)
        self.told_to_end = False

    def now(self) -> int:
        """Return the device's time in µs."""
        return self._clock.now() - self._start

    def run(self, stopping: Callable[[], bool], ready: Callable[[str], None] = lambda url: None) -> None:
        """Run the event loop until ``stopping()`` returns true or an end is requested.

        The shutter then closes and the hardware stops.
        """
        try:
            ready(self._endpoint.url)
            while not (self.told_to_end or stopping()):
                self.run_once()
                self._wait()
        finally:
            with ExitStack() as ending:  # each of them whatever becomes of those before it
                ending.callback(self._endpoint.close)
                ending.callback(self._instrument.stop, self.now())
                ending.callback(self._instrument.close)

    def run_once(self) -> None:
        """Process received bytes, execute due actions, and send as many bytes as the line accepts."""
        self.device.receive(self._endpoint.read(CHUNK), self.now())
        if not self._out:
            self._out = self.device.next_frames(MAX_FRAME_BYTES)
        if self._out:
            self._out = self._out[self._endpoint.write(self._out) :]

    def _wait(self) -> None:
        left = min(IDLE_INTERVAL, max(0.0, (self.device.next_deadline() - self.now()) * 1e-6))
        descriptors, writable = self._endpoint.descriptors(), self._endpoint.writable_descriptor()
        if not descriptors or (self._out and writable is None):
            left = min(left, BLIND_INTERVAL)
        if descriptors:
            select.select(descriptors, [writable] if self._out and writable is not None else [], [], left)
        else:
            time.sleep(left)


def serve(
    instrument: Instrument,
    port: str,
    *,
    baudrate: int = 3_000_000,
    stopping: Callable[[], bool] = lambda: False,
    ready: Callable[[str], None] = lambda url: None,
    ring: int = 512,
    plan_points: int = 8192,
    max_payload: int | None = None,
) -> None:
    """Serve ``instrument`` as a scanner on a port, by the serial protocol, until Ctrl-C or SIGTERM.

    What a host asks for is done by the very device that the simulator runs: lease, arming, exactly-once A-lines,
    latched faults. The laser's lease is also the limit of :meth:`~fabry_perot.hardware.Instrument.permit`, which a
    timer of the hardware keeps: a program, or an operating system, that hangs fires nothing beyond it. What firmware
    owes besides (a watchdog, a shutter that closes without power) stays the hardware's.

    Parameters
    ----------
    instrument
        The hardware, for example an :class:`~fabry_perot.hardware.ComposedInstrument`.
    port
        Path of a serial port, or ``socket://HOST:PORT`` to listen at (port 0: any free one).
    baudrate
        Baud rate of a UART.
    stopping
        Asked some fifty times a second whether to end.
    ready
        Told the URL under which a host finds the scanner.
    ring, plan_points
        A-lines and points held.
    max_payload
        Largest payload in bytes; by default 641 on a serial port, which suits a UART (USB carries 8192), 32768 on TCP.

    Raises
    ------
    OSError
        The port cannot be opened.
    InstrumentError
        The hardware cannot say what its limits are.
    """
    endpoint: Endpoint
    if port.startswith("socket://"):
        endpoint, payload = TcpEndpoint(port.removeprefix("socket://")), MAX_PAYLOAD
    else:
        endpoint, payload = SerialEndpoint(port, baudrate), UART_PAYLOAD
    try:
        service = DeviceServer(
            instrument, endpoint, ring=ring, plan_points=plan_points, max_payload=max_payload or payload
        )
    except BaseException:
        endpoint.close()
        raise
    with _told_by_sigterm(service):
        service.run(stopping, ready)
    if service.told_to_end:
        sys.exit(128 + signal.SIGTERM)


@contextmanager
def _told_by_sigterm(service: DeviceServer) -> Iterator[None]:
    """Install a SIGTERM handler that ends the event loop, unless the program has its own handler.

    The handler raises nothing, so that it cannot come between the service and the closing of the shutter.
    """
    mine = threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGTERM) == signal.SIG_DFL

    def tell(*_: object) -> None:
        service.told_to_end = True

    if mine:
        signal.signal(signal.SIGTERM, tell)
    try:
        yield
    finally:
        if mine:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
