"""What the fuzzers drive: raw bytes into the deframer, and valid frames with arbitrary payloads into both ends."""

from __future__ import annotations

from typing import Any

import numpy as np

from fabry_perot.device import Device
from fabry_perot.errors import DeviceRestarted, FrameError, ProtocolMismatch, ScannerError
from fabry_perot.hardware.instrument import PlanSampling, PointRecord
from fabry_perot.host import Host, WirePlan
from fabry_perot.wire.constants import PROTOCOL, Operation, Type
from fabry_perot.wire.framing import Deframer, Frame, encode_frame
from fabry_perot.wire.messages import POINT, Hello, pack

FROM_HOST = [kind for kind in Type if not kind & 0x80]
FROM_DEVICE = [kind for kind in Type if kind & 0x80]


class NullInstrument:
    """Hardware that costs nothing."""

    def __init__(self) -> None:
        self.samples, self.count, self.last, self.until, self.swept_at = 16, 0, 0, 0, 0
        self.points: list[int] = []
        self.levels: list[int] = []

    def capabilities(self) -> dict[str, Any]:
        span = [0, 1_000_000]
        names = ("x_nm", "y_nm", "interval_ps", "pulse_rate_mhz", "averages", "wavelength_pm")
        ranges: dict[str, Any] = dict.fromkeys(names, span)
        fixed = {"model": "", "serial": "", "simulated": True, "adc_bits": 16, "beams": 1, "clock_rate": 1.0}
        limits = {"encodings": [0, 1], "line_rate": 0, "tuning_us": 1, "parameters": {"p": [0, 9]}}
        return {**ranges, **fixed, **limits, "samples": [1, 64], "pulse_rate_mhz": [1000, 1_000_000]}

    def begin(self, sampling: PlanSampling) -> None:
        self.samples = sampling.samples

    def queue_points(self, first: int, points: Any, now: int) -> None:
        self.points += range(first, first + len(points))

    def permit(self, until: int, now: int) -> None:
        self.until = until

    def poll(self, now: int) -> list[PointRecord]:
        done: list[PointRecord] = []
        while self.points and self.last + 1000 <= now and self.last + 1000 < self.until:
            self.last, self.count = self.last + 1000, self.count + 1
            samples = np.zeros(self.samples, np.int16)
            done.append(PointRecord(samples, 1.0, self.points.pop(0), self.last, self.count))
        return done

    def next_due(self, now: int) -> int | None:
        return self.last + 1000 if self.points else None

    def stop(self, now: int) -> None:
        self.points.clear()

    def shots(self) -> int:
        return self.count

    def last_shot(self) -> int:
        return self.last

    def park(self, now: int) -> None: ...

    def open(self) -> None: ...

    def close(self) -> None: ...

    def shutter_open(self) -> bool:
        return False

    def emitting(self) -> bool:
        return False

    def key_on(self) -> bool:
        return True

    def position(self) -> tuple[int, int]:
        return 0, 0

    def interlock_closed(self) -> bool:
        return True

    def parameters(self) -> dict[str, int]:
        return {}

    def configure(self, name: str, value: int) -> None: ...

    def sweep(self, x: int, y: int, wavelengths: Any, now: int) -> None:
        self.swept_at, self.levels = now + 10, [0] * len(wavelengths)

    def sweep_result(self, now: int) -> list[int] | None:
        return self.levels if now >= self.swept_at else None


def deframer(data: bytes) -> None:
    """Any bytes in any pieces: no exception, bounded memory, and what comes out goes back in."""
    whole, pieces = Deframer(), Deframer()
    size = 1 + (data[0] if data else 0)
    frames = whole.feed(data)
    again: list[Frame] = []
    for at in range(0, len(data), size):
        again += pieces.feed(data[at : at + size])
    assert again == frames or whole.counters.oversize != pieces.counters.oversize
    for frame in frames:
        assert frame in Deframer().feed(encode_frame(frame))


def _messages(data: bytes, kinds: list[Type]) -> list[tuple[Type, bytes]]:
    """Cut the input into messages: one byte of type, one of length, the payload."""
    messages = []
    while len(data) >= 2:
        size = data[1]
        messages.append((kinds[data[0] % len(kinds)], data[2 : 2 + size]))
        data = data[2 + size :]
    return messages


def device(data: bytes) -> None:
    """Valid frames of every type with any payload: no exception, no shot without a lease, the ring's books right."""
    target = Device(NullInstrument(), boot=7, ring=8, plan_points=16, max_payload=200)
    target.receive(encode_frame(Frame(Type.HELLO, 0, 0, 0, 1, pack(Hello(PROTOCOL, PROTOCOL, 200, 3)))), 1000)
    now = 1000
    for kind, payload in _messages(data, FROM_HOST):
        now += 700
        target.receive(encode_frame(Frame(kind, 0, 7, target.outbox.session, 0, payload)), now)
        target.next_frames(1000)
        assert target.ring.used == target.ring.produced - target.ring.acknowledged <= 8
        assert target.next_deadline() >= target.now
        assert target.scan.last_shot < max(1, target.lease.until) or target.state.name != "SCANNING"


def _connected() -> tuple[Host, Device]:
    host, peer = Host(3), Device(NullInstrument(), boot=7, ring=8, max_payload=200)
    host.open(0)
    for now in range(1000, 30_000, 1000):
        peer.receive(host.take_output(), now)
        host.receive(peer.next_frames(4000), now)
    points = np.zeros(5, POINT)
    points["averages"] = 1
    host.upload(WirePlan(points, 16, 8000, 50_000), 30_000)
    for now in range(31_000, 40_000, 1000):
        peer.receive(host.take_output(), now)
        host.receive(peer.next_frames(4000), now)
    return host, peer


def host(data: bytes) -> None:
    """Valid frames of every type with any payload: nothing but the driver's own errors, A-lines in order."""
    target, _ = _connected()
    now, number = 40_000, 0
    for kind, payload in _messages(data, FROM_DEVICE):
        now += 700
        if kind == Type.RSP and len(payload) > 2:
            payload = payload[:2] + bytes([payload[2] % len(Operation)]) + payload[3:]
        target.receive(encode_frame(Frame(kind, 0, 7, target.session, 0, payload)), now)
        for line in target.take():
            assert line.number == number
            number += 1
        target.take_output()
        if target.failure is not None:
            assert isinstance(target.failure, DeviceRestarted | ProtocolMismatch | FrameError | ScannerError)
            return


TARGETS = {"deframer": deframer, "device": device, "host": host}
