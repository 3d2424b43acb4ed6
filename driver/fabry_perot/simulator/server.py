"""The simulator's loop: device time, line and phantom in one thread of their own process."""

from __future__ import annotations

import secrets
import select
from collections.abc import Callable

from fabry_perot.clock import ScaledClock
from fabry_perot.device import Device, DeviceTiming
from fabry_perot.framing import MAX_PAYLOAD, UART_PAYLOAD
from fabry_perot.phantoms import yarn
from fabry_perot.simulator.endpoints import CHUNK, Endpoint, PtyEndpoint, TcpEndpoint
from fabry_perot.simulator.instrument import PhantomInstrument
from fabry_perot.simulator.options import Options
from fabry_perot.simulator.pacing import Pacer

LAG = 0.02
"""Device time may fall behind the scaled clock by so many real seconds before the clock is held back."""
PULL = 16384
"""Bytes taken from the device at a time."""


def open_endpoint(options: Options) -> Endpoint:
    """Return the line the options ask for."""
    return TcpEndpoint(options.tcp) if options.tcp else PtyEndpoint(options.link)


def build_device(options: Options) -> Device:
    """Return the simulated scanner the options ask for."""
    line_rate = options.baud // 10
    instrument = PhantomInstrument(
        yarn(options.seed),
        sound_speed=options.sound_speed,
        seed=options.seed,
        noise_db=options.noise_db,
        clock_rate=options.speed,
        line_rate=line_rate,
    )
    return Device(
        instrument,
        boot=options.boot or 1 + secrets.randbelow(0xFFFFFFFE),
        timing=DeviceTiming().scaled(options.speed),
        ring=options.ring,
        max_payload=UART_PAYLOAD if options.baud else MAX_PAYLOAD,
    )


class Server:
    """Runs a device on an endpoint.

    Device time follows a scaled clock event by event, with a look at the line between any two events. When an A-line
    takes longer to compute than the clock allows, the clock waits: nothing is skipped or invented.

    Parameters
    ----------
    device, endpoint
        What to run where.
    speed
        Device seconds per second.
    baud
        Pace of the line in device time; 0 for none.
    """

    def __init__(self, device: Device, endpoint: Endpoint, speed: float, baud: int) -> None:
        self._device, self._endpoint, self._speed = device, endpoint, speed
        self._clock = ScaledClock(speed)
        self._down, self._up = Pacer(baud), Pacer(baud)
        self._out = b""
        self._time = 0

    def run(self, finished: Callable[[list[int]], bool], watched: list[int]) -> None:
        """Run until ``finished(readable descriptors)``; ``watched`` are waited on besides the line."""
        readable: list[int] = []
        while not finished(readable):
            self.turn()
            readable = self._wait(watched)

    def turn(self) -> None:
        """Take in what arrived, move device time on by one event at most, send what the line takes."""
        present = self._clock.now()
        if present - self._time > LAG * 1e6 * self._speed:
            due = self._device.next_due()
            if due < present:
                present = max(self._time, due)
                self._clock.hold(present)
        self._time = max(self._time, min(present, self._device.next_due()))
        data = self._endpoint.read(self._up.allowance(present, CHUNK))
        self._up.spend(len(data))
        self._device.receive(data, self._time)
        if not self._out:
            self._out = self._device.pull(min(PULL, self._down.allowance(present, PULL)))
        allowed = self._down.allowance(present, len(self._out))
        if self._out and allowed:
            sent = self._endpoint.write(self._out[:allowed])
            self._down.spend(sent)
            self._out = self._out[sent:]

    def _wait(self, watched: list[int]) -> list[int]:
        left = (self._device.next_due() - self._clock.now()) / (1e6 * self._speed)
        blocked = bool(self._out)
        writable = self._endpoint.writable_descriptor()
        wanted = [writable] if blocked and writable is not None and not self._down.limited else []
        if self._down.limited or self._up.limited:
            left = min(left, 0.002)
        readable, _, _ = select.select([*self._endpoint.descriptors(), *watched], wanted, [], max(0.0, min(left, 0.1)))
        return readable
