"""Event loop of the simulator: device time, line and phantom in one thread of their own process."""

from __future__ import annotations

import select
import time
from collections import deque
from collections.abc import Callable
from typing import Protocol

from fabry_perot.clock import ScaledClock
from fabry_perot.device.endpoints import CHUNK, Endpoint
from fabry_perot.device.tcp import TcpEndpoint
from fabry_perot.simulator.baud_rate_limiter import BaudRateLimiter
from fabry_perot.simulator.line_faults import BitFlips, FilterChain, FrameLoss
from fabry_perot.simulator.options import Options
from fabry_perot.simulator.power_cycle import PoweredDevice

MAX_LAG = 0.02
"""Device time may fall behind the scaled clock by so many real seconds before the clock is held back."""
MAX_FRAME_BYTES = 16384
"""Bytes taken from the device at a time."""
SHUTTER_LOG = 2000
"""Movements of the shutter that are kept."""


class PluggableEndpoint(Endpoint, Protocol):
    """Interface of an endpoint that can be unplugged and plugged in again."""

    def unplug(self) -> None:
        """Disconnect the line, like an unplugged cable."""
        ...

    def plug(self) -> None:
        """Reconnect the line after :meth:`unplug`."""
        ...


def open_endpoint(options: Options) -> PluggableEndpoint:
    """Open the endpoint that the options select."""
    if options.tcp:
        return TcpEndpoint(options.tcp)
    from fabry_perot.simulator.terminal import PtyEndpoint

    return PtyEndpoint(options.link)


class Server:
    """Event loop that runs a simulated device on an endpoint.

    Device time follows a scaled clock event by event, with a look at the line between any two events. When an A-line
    takes longer to compute than the clock allows, the clock waits: nothing is skipped or invented.

    Parameters
    ----------
    machine, endpoint
        What to run where.
    options
        Settings.
    """

    def __init__(self, machine: PoweredDevice, endpoint: PluggableEndpoint, options: Options) -> None:
        self.machine, self.endpoint, self._speed = machine, endpoint, options.speed
        self._clock = ScaledClock(options.speed)
        self._down, self._up = BaudRateLimiter(options.baud), BaudRateLimiter(options.baud)
        self.up, self.down = FilterChain(), FilterChain()
        """Faults on the way to the device, and from it."""
        for number, chain in enumerate((self.up, self.down)):
            if options.bit_errors:
                chain.filters.append(BitFlips(2 * options.seed + number, options.bit_errors))
            if options.lost_frames:
                chain.filters.append(FrameLoss(2 * options.seed + number, options.lost_frames))
        self._out = b""
        self._plug_at: int | None = None
        self.time = 0
        """Simulator time in µs."""
        self.shutter_log: deque[tuple[int, float, bool]] = deque([(0, time.monotonic(), False)], SHUTTER_LOG)
        """Last movements of the shutter: simulator time in µs, monotonic clock in s, whether it opened."""

    def run(self, finished: Callable[[list[int]], bool], watched: list[int]) -> None:
        """Run until ``finished(readable descriptors)`` is true; the loop also waits on ``watched`` descriptors."""
        readable: list[int] = []
        while not finished(readable):
            self.run_once()
            readable = self._wait(watched)

    def unplug(self, duration: int) -> None:
        """Disconnect the line for ``duration`` µs; bytes in transit are lost."""
        if self._plug_at is None:
            self.endpoint.unplug()
        self._out, self._plug_at = b"", self.time + duration

    def run_once(self) -> None:
        """Process received bytes, advance device time by one event at most, send as many bytes as the line accepts."""
        present = self._clock.now()
        if present - self.time > MAX_LAG * 1e6 * self._speed:
            due = self.machine.next_due(self.time)
            if due < present:
                present = max(self.time, due)
                self._clock.rewind_to(present)
        self.time = max(self.time, min(present, self.machine.next_due(self.time)))
        if self._plug_at is not None:
            self._run_unplugged(self._plug_at)
            return
        data = self.endpoint.read(self._up.available(self.time, CHUNK))
        self._up.consume(len(data))
        self.machine.receive(self.up(data, self.time), self.time)
        self._note_shutter()
        if not self._out:
            pulled = self.machine.pull(min(MAX_FRAME_BYTES, self._down.available(self.time, MAX_FRAME_BYTES)))
            self._out = self.down(pulled, self.time)
        allowed = self._down.available(self.time, len(self._out))
        if self._out and allowed:
            sent = self.endpoint.write(self._out[:allowed])
            self._out = self._out[sent:]
            self._down.consume(sent, busy=sent == allowed and bool(self._out))

    def _note_shutter(self) -> None:
        is_open = self.machine.instrument.shutter_open()
        if is_open != self.shutter_log[-1][2]:
            self.shutter_log.append((self.time, time.monotonic(), is_open))

    def _run_unplugged(self, plug_at: int) -> None:
        self.machine.receive(b"", self.time)
        self._note_shutter()
        self.machine.pull(MAX_FRAME_BYTES)  # into the void
        if self.time >= plug_at:
            self.endpoint.plug()
            self._plug_at = None

    def _wait(self, watched: list[int]) -> list[int]:
        left = (self.machine.next_due(self.time) - self._clock.now()) / (1e6 * self._speed)
        writable = self.endpoint.writable_descriptor()
        wanted = [writable] if self._out and writable is not None and not self._down.limited else []
        if self._down.limited or self._up.limited or self._plug_at is not None:
            left = min(left, 0.002)
        descriptors = [*self.endpoint.descriptors(), *watched]
        readable, _, _ = select.select(descriptors, wanted, [], max(0.0, min(left, 0.1)))
        return readable
