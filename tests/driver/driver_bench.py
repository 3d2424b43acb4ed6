"""A bench: host and device joined by an in-memory line with faults, driven by a virtual clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
from driver_clock import VirtualClock

from fabry_perot.device import Device
from fabry_perot.errors import RequestRejected, ResponseTimeout
from fabry_perot.hardware.instrument import InstrumentError, PlanSampling, PointRecord
from fabry_perot.host import Host, WirePlan
from fabry_perot.simulator.line_faults import Filter, FilterChain
from fabry_perot.wire.constants import Operation
from fabry_perot.wire.messages import POINT
from fabry_perot.wire.states import DeviceState

STEP = 1_000
DEVICE_EPOCH = 7_000_000
CAPABILITIES = {
    "model": "bench",
    "serial": "0",
    "simulated": True,
    "x_nm": [-10_000_000, 10_000_000],
    "y_nm": [-10_000_000, 10_000_000],
    "samples": [1, 8192],
    "interval_ps": [1, 1_000_000],
    "pulse_rate_mhz": [1, 10_000_000],
    "averages": [1, 100],
    "wavelength_pm": [1_500_000, 1_600_000],
    "adc_bits": 16,
    "beams": 1,
    "encodings": [0, 1],
    "tuning_us": 1000,
    "parameters": {"power": [0, 10]},
    "clock_rate": 1.0,
    "line_rate": 0,
}


class NotReached(AssertionError):
    """What was waited for did not come."""


class CountingInstrument:
    """Records a pattern that depends on the point alone, and logs every shot and every move of the shutter."""

    def __init__(self, **limits: object) -> None:
        self.limits = limits
        self.open_now, self.stuck, self.key = False, False, True
        self.shutter: list[str] = []
        self.broken: str | None = None
        self.log: list[tuple[int, int, int]] = []
        self.on_fire: Callable[[int], None] = lambda now: None
        self.period = 5_000
        self.moving = 700
        self.samples, self.beams = 64, 1
        self.make: Callable[[int], np.ndarray] = lambda index: truth(index, self.samples)
        self.closed = True
        self.values = {"power": 1}
        self.tuning = 40_000
        self.waiting: deque[tuple[int, int, int]] = deque()
        self.settled: int | None = None
        self.fired = self.until = self.last = 0
        self.done: list[PointRecord] = []
        self.sweeping: tuple[int, list[int]] | None = None

    def capabilities(self):
        return {**CAPABILITIES, **self.limits}

    def begin(self, sampling: PlanSampling) -> None:
        self.samples, self.beams = sampling.samples, sampling.beams
        self.period = round(1e9 / sampling.pulse_rate_mhz)

    def queue_points(self, first: int, points, now: int) -> None:
        for index, point in enumerate(points, start=first):
            self.waiting.append((index, max(1, int(point["averages"])), 100 * int(point["settle"])))
        self.aim(now)

    def aim(self, now: int) -> None:
        if self.settled is None and self.waiting:
            self.settled, self.fired = now + self.moving + self.waiting[0][2], 0

    def permit(self, until: int, now: int) -> None:
        self.until = until

    def due(self) -> int | None:
        if self.settled is None:
            return None
        return -(-max(self.settled, self.last + 1) // self.period) * self.period

    def poll(self, now: int) -> list[PointRecord]:
        while (time := self.due()) is not None and time <= now and time < self.until and self.open_now:
            index, averages, _ = self.waiting[0]
            self.log.append((time, index, len(self.log) + 1))
            self.last, self.fired = time, self.fired + 1
            self.on_fire(time)
            if self.fired == averages:
                for beam in range(self.beams):
                    line = self.make(index * self.beams + beam)
                    self.done.append(PointRecord(line, 0.25, index, time, len(self.log), averages, beam=beam))
                self.waiting.popleft()
                self.settled = None
                self.aim(time)
        done, self.done = self.done, []
        return done

    def next_due(self, now: int) -> int | None:
        return self.sweeping[0] if self.sweeping else self.due()

    def stop(self, now: int) -> None:
        self.waiting.clear()
        self.settled = self.sweeping = None

    def shots(self) -> int:
        return len(self.log)

    def last_shot(self) -> int:
        return self.last

    def sweep(self, x: int, y: int, wavelengths, now: int) -> None:
        self.sweeping = now + self.tuning, [int(w % 1000) for w in wavelengths]

    def sweep_result(self, now: int) -> list[int] | None:
        if self.sweeping is None or now < self.sweeping[0]:
            return None
        (_, levels), self.sweeping = self.sweeping, None
        return levels

    def open(self) -> None:
        self.shutter.append("open")
        self.open_now = True

    def close(self) -> None:
        self.shutter.append("close")
        self.open_now = self.stuck and self.open_now

    def shutter_open(self) -> bool:
        return self.open_now

    def emitting(self) -> bool:
        return self.open_now and self.key and self.closed

    def interlock_closed(self) -> bool:
        return self.closed

    def key_on(self) -> bool:
        return self.key

    def park(self, now: int) -> None: ...

    def position(self) -> tuple[int, int]:
        return 0, 0

    def parameters(self) -> dict[str, int]:
        return dict(self.values)

    def configure(self, name: str, value: int) -> None:
        self.values[name] = value

    def __getattribute__(self, name: str):
        if name == object.__getattribute__(self, "__dict__").get("broken"):
            return self.fail
        return object.__getattribute__(self, name)

    def fail(self, *given: object) -> None:
        raise InstrumentError(9, f"{self.__dict__['broken']} failed")


def truth(index: int, samples: int) -> np.ndarray:
    return np.random.default_rng(index).integers(-32768, 32768, samples, dtype=np.int16)


class Line:
    """One direction of a line: a list of filters, each ``bytes, now -> bytes``, then a delay."""

    def __init__(self, *filters: Filter, delay: int = 300) -> None:
        self.chain, self.delay = FilterChain(filters), delay
        self.filters = self.chain.filters
        self._queue: deque[tuple[int, bytes]] = deque()

    def put(self, data: bytes, now: int) -> None:
        data = self.chain(data, now)
        if data:
            self._queue.append((now + self.delay, data))

    def get(self, now: int) -> bytes:
        parts = []
        while self._queue and self._queue[0][0] <= now:
            parts.append(self._queue.popleft()[1])
        return b"".join(parts)


class Bench:
    """Host, device, line and consumer under one virtual clock."""

    def __init__(self, *, ring: int = 32, plan_points: int = 8192, max_payload: int = 8192, **limits: object) -> None:
        self.clock = VirtualClock()
        self.instrument = CountingInstrument(**limits)
        self.options = {"ring": ring, "plan_points": plan_points, "max_payload": max_payload}
        self.device = self.boot(0xB007)
        self.host = Host(nonce=1)
        self.up, self.down = Line(), Line()
        self.stored: list = []
        self.host_alive = self.consuming = self.acknowledging = True
        self.lease_ok: list[bool] = []
        self.instrument.on_fire = lambda now: self.lease_ok.append(self.device.lease.permits(now))

    def boot(self, boot: int) -> Device:
        return Device(self.instrument, boot=boot, now=self.device_now, **self.options)

    @property
    def device_now(self) -> int:
        return self.clock.now() + DEVICE_EPOCH

    def turn(self) -> None:
        """One step of 1 ms: line, host, consumer, device."""
        self.clock.advance(STEP)
        now = self.clock.now()
        if self.host_alive:
            self.host.receive(self.down.get(now), now)
            if self.consuming:
                self.host.renew(now)
                batch = self.host.take()
                self.stored += batch
                if batch and self.acknowledging:
                    self.host.acknowledge(batch[-1].number, now)
            self.up.put(self.host.take_output(), now)
        else:
            self.up.put(b"", now)
            self.down.get(now)
        while (due := self.device.next_deadline()) < self.device_now and due > self.device.now:
            self.device.poll(due)
        self.device.receive(self.up.get(now), self.device_now)
        self.down.put(self.device.next_frames(16384), now)

    def until(self, ready: Callable[[], bool], limit_ms: int = 60_000) -> int:
        """Turn until ``ready()``; returns the ms it took and fails beyond the limit."""
        for count in range(limit_ms):
            if ready():
                return count
            self.turn()
        raise NotReached(f"not reached in {limit_ms} ms: {self.host.state}, {self.device.state}")

    def run(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            self.turn()

    def call(self, operation: Operation, **body):
        call = self.host.call(operation, self.clock.now(), **body)
        self.until(lambda: call.done)
        return call.result()

    def connect(self) -> None:
        self.host.open(self.clock.now())
        self.until(lambda: self.host.capabilities is not None and self.host.status is not None)

    def upload(
        self, count: int = 50, *, samples: int = 64, averages: int = 1, rate: float = 200.0, beams: int = 1
    ) -> WirePlan:
        points = np.zeros(count, POINT)
        points["x"] = np.arange(count) * 1000
        points["averages"] = averages
        plan = WirePlan(np.repeat(points, beams), samples, 8000, round(rate * 1e3), beams=beams)
        call = self.host.upload(plan, self.clock.now())
        self.until(lambda: call.done and self.device.plan.loaded and self.device.state.name == "READY")
        return plan

    def start(self) -> None:
        token = self.call(Operation.ARM)["token"]
        self.call(Operation.START, token=token, **self.host.lease_fields())

    def scan(self, count: int = 50, **parameters) -> None:
        """Connect, upload, arm, start; the scan then runs by turns."""
        self.connect()
        self.upload(count, **parameters)
        self.start()

    def finish(self) -> None:
        """Turn until the device is done and the host knows."""
        self.until(lambda: self.device.state is DeviceState.DONE)
        self.run(20)

    def finish_with_resumes(self) -> None:
        """Noise may well kill a lease: then a person resumes, as the driver's user would."""
        for _ in range(50):
            self.until(lambda: self.device.state in (DeviceState.DONE, DeviceState.SAFE_HOLD))
            if self.device.state is DeviceState.DONE:
                self.run(500)
                return
            try:
                self.call(Operation.RELEASE)
                self.start()
            except (RequestRejected, ResponseTimeout):
                self.run(100)
        raise AssertionError("not done after 50 resumes")

    def check_exact(self, count: int) -> None:
        """Every A-line came exactly once, in order, bit by bit; every shot lay inside a lease."""
        assert [line.number for line in self.stored] == list(range(count))
        for line in self.stored:
            assert np.array_equal(line.samples, truth(line.point, len(line.samples)))
        assert all(self.lease_ok)
