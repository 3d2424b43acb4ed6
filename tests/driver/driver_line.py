"""A device at the other end of a line in virtual time, and what the conformance scenarios find of it."""

from __future__ import annotations

from driver_bench import CountingInstrument
from driver_clock import VirtualClock

from fabry_perot.conformance import ConformanceHost, run
from fabry_perot.device import Device
from fabry_perot.device.timing import DeviceTiming


class VirtualLine:
    """A device under a virtual clock, at the other end of a line that takes no time; each read is a millisecond.

    Parameters
    ----------
    speed
        Declared device seconds a second; its capabilities must say the same.
    pace
        Real device seconds a second; by default the declared ones.
    limits
        Of the device.
    """

    def __init__(self, speed: int = 1, pace: int = 0, **limits: int) -> None:
        self.clock, self.limits = VirtualClock(1_000_000), limits
        self.speed, self.pace = speed, pace or speed
        self.instrument = CountingInstrument()
        self.boots, self.sent = 0, b""
        self.boot()

    def boot(self) -> None:
        self.boots += 1
        boot, timing = 0xB000 + 7 * self.boots, DeviceTiming().scaled(self.speed)
        now = self.clock.now() * self.pace
        self.device = Device(self.instrument, boot=boot, now=now, timing=timing, **self.limits)

    def write(self, data: bytes) -> None:
        self.sent += data

    def read(self) -> bytes:
        before = self.clock.now()
        self.clock.advance(1_000)
        data, self.sent = self.sent, b""
        step = 1_000 if self.pace == 1 else 250 * self.pace
        for now in range(before * self.pace + step, self.clock.now() * self.pace + 1, step):
            self.device.receive(data, now)
            data = b""
        return self.device.next_frames(16384)

    def close(self) -> None: ...

    def ask(self, wish: str) -> None:
        """Do what a person is asked for."""
        if "interlock" in wish:
            self.instrument.closed = "close" in wish
        else:
            self.boot()


def outcomes(*only: str, speed: int = 1, pace: int = 0, **limits: int) -> dict[str, str]:
    line = VirtualLine(speed, pace, **{"ring": 16, **limits})
    found = run(ConformanceHost(line, line.clock), fire=True, ask=line.ask, only=only)
    return {outcome.name: outcome.failure or outcome.skipped for outcome in found}
