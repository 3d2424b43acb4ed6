"""A device at the other end of a line in virtual time, and what the conformance scenarios find of it."""

from __future__ import annotations

from driver_bench import CountingInstrument

from fabry_perot.clock import VirtualClock
from fabry_perot.conformance import Peer, run
from fabry_perot.device import Device


class VirtualLine:
    """A device under a virtual clock, at the other end of a line that takes no time; each read is a millisecond."""

    def __init__(self, **limits: int) -> None:
        self.clock, self.limits = VirtualClock(1_000_000), limits
        self.instrument = CountingInstrument()
        self.boots, self.sent = 0, b""
        self.boot()

    def boot(self) -> None:
        self.boots += 1
        self.device = Device(self.instrument, boot=0xB000 + 7 * self.boots, now=self.clock.now(), **self.limits)

    def write(self, data: bytes) -> None:
        self.sent += data

    def read(self) -> bytes:
        self.clock.advance(1_000)
        data, self.sent = self.sent, b""
        self.device.receive(data, self.clock.now())
        return self.device.pull(16384)

    def close(self) -> None: ...

    def ask(self, wish: str) -> None:
        """Do what a person is asked for."""
        if "interlock" in wish:
            self.instrument.closed = "close" in wish
        else:
            self.boot()


def outcomes(*only: str, **limits: int) -> dict[str, str]:
    line = VirtualLine(**{"ring": 16, **limits})
    found = run(Peer(line, line.clock), fire=True, ask=line.ask, only=only)
    return {outcome.name: outcome.failure or outcome.skipped for outcome in found}
