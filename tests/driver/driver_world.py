"""A whole scan under a virtual clock with an application that may hang, die or run out of disk, and its invariants.

What is checked is written against the bytes the device was really given and what the application really did, read by
the reference decoder: it does not believe the device's own lease or the host's own books.
"""

from __future__ import annotations

import struct
from contextlib import suppress

import numpy as np
from driver_bench import Bench, truth
from driver_faults import Recorder
from driver_reference import frames

from fabry_perot.errors import RequestRejected, ScannerError
from fabry_perot.host import Host, RecoveryPolicy, ScanRecovery, WirePlan
from fabry_perot.wire.constants import AbortLevel, Operation
from fabry_perot.wire.messages import POINT, unpack_body
from fabry_perot.wire.states import RUNNING, DeviceState

TTL = 500_000
HALTED = frozenset({DeviceState.ESTOP, DeviceState.FAULT, DeviceState.PAUSED, DeviceState.SAFE_HOLD})


class World(Bench):
    """A bench with a keeper, an application, and a judge of every shot."""

    def __init__(self, points: int = 40, **options) -> None:
        super().__init__(**{"ring": 12, "plan_points": 24, "max_payload": 641, **options})
        records = np.zeros(points, POINT)
        records["x"] = np.arange(points) * 1000
        records["averages"] = 1
        self.plan = WirePlan(records, 300, 8000, 200_000)
        self.count, self.nonce, self.boots = points, 1, 1
        self.keeper = ScanRecovery(self.host, RecoveryPolicy(patience=1e9))
        self.memory: list = []
        self.disk: dict[int, object] = {}
        self.disk_full = self.hung = self.plugged_out = self.asleep = False
        self.slept = 0
        self.dark_until = self.back_at = 0
        self.permission = self.alive_at = 0
        self.stopped_at: int | None = None
        self.recorder = Recorder(1 << 18)
        self.up.filters.append(self.recorder)
        self.instrument.on_fire = self.judge

    def judge(self, now: int) -> None:
        """Every shot lies inside a lease that the host gave, and gave while its application was alive."""
        time = self.device_now
        assert now <= time, "a shot in the future"
        assert now < self.permission, f"a shot {now - self.permission} µs after the last lease ended"
        assert now < self.alive_at + TTL, "a shot although the application was gone for longer than the TTL"
        assert self.stopped_at is None or now < self.stopped_at + TTL, "a shot long after an abort"

    def deliver(self, data: bytes) -> None:
        """Give the device bytes, noting what they permit as the document says."""
        session, tag = self.device.outbox.session, self.device.boot & 0xFF
        for frame in frames(data):
            payload = frame["payload"]
            if frame["type"] == 0x31 and len(payload) == 5:
                self.permission = 0
            if frame["type"] == 0x01 and len(payload) == 8:
                (nonce,) = struct.unpack_from("<I", payload, 4)
                self.permission = self.permission if nonce == self.device.nonce else 0
            if (frame["session"], frame["boot"]) != (session, tag):
                continue
            if frame["type"] == 0x30:
                _, echo, ttl = struct.unpack("<IQI", payload)
                self.permit(echo, ttl)
            elif frame["type"] == 0x03 and payload[2] == Operation.START:
                body = unpack_body(payload[3:])
                self.permit(body["echo"], body["ttl"])

    def permit(self, echo: int, ttl: int) -> None:
        self.permission = max(self.permission, min(echo, self.device_now) + min(ttl, 1_000_000))

    @property
    def host_now(self) -> int:
        """The host's clock, which leaves out the time its computer was asleep."""
        return self.clock.now() - self.slept

    def turn(self) -> None:
        self.clock.advance(1_000)
        self.slept += 1_000 if self.asleep else 0
        now = self.host_now
        self.plug(now)
        if self.asleep:
            pass
        elif self.host_alive:
            self.host.receive(b"" if self.plugged_out else self.down.get(now), now)
            self.application(now)
            self.up.put(self.host.take_output(), now)
        else:
            self.up.put(b"", now)
        data = self.up.get(now)
        if self.device_now < self.dark_until:
            return
        while (due := self.device.next_deadline()) < self.device_now and due > self.device.now:
            self.device.poll(due)
        self.deliver(data)
        self.device.receive(data, self.device_now)
        sent = self.device.next_frames(16384)
        self.down.put(b"" if self.plugged_out else sent, now)
        self.audit()

    def audit(self) -> None:
        """Un-acknowledged data never vanish: what is not in the ring is in the application's hands."""
        ring = self.device.ring
        assert ring.used == ring.produced - ring.acknowledged <= ring.capacity
        kept = len(self.disk) + len(self.memory) if self.host_alive else len(self.disk)
        if ring.plan == self.plan.uid and self.host_alive and self.host.assembly is not None:
            assert ring.acknowledged <= max(kept, self.host.assembly.complete)

    def plug(self, now: int) -> None:
        if self.plugged_out and now >= self.back_at:
            self.plugged_out = False
            if self.host_alive:
                self.nonce += 1
                self.host.reopen(self.nonce, now)

    def application(self, now: int) -> None:
        """Take, store, acknowledge, as ``Scanner.alines`` does for its consumer."""
        if self.hung:
            return
        self.alive_at = self.device_now
        self.host.renew(now)
        self.keeper.poll(now)
        if not self.memory:
            self.memory = self.host.take()
        if self.memory and not self.disk_full:
            for line in self.memory:
                assert line.number == len(self.disk), f"A-line {line.number} after {len(self.disk)}"
                assert np.array_equal(line.samples, truth(line.point, 300)), "stored ⊆ truth"
                self.disk[line.number] = line
            self.host.acknowledge(self.memory[-1].number, now)
            self.memory = []

    def begin(self) -> None:
        """Connect, upload and start; an operator who tries again when the line spoils it."""
        self.connect()
        self.call_upload()
        self.go()

    def call_upload(self) -> None:
        call = self.host.upload(self.plan, self.clock.now(), len(self.disk))
        self.until(lambda: call.done, 40_000)
        call.result()
        self.until(lambda: self.host.failure or self.host.device_state is not DeviceState.LINKED, 5_000)

    def clear(self) -> None:
        """Clear what is latched, unless its cause stands."""
        if self.host.device_state in (DeviceState.ESTOP, DeviceState.FAULT):
            with suppress(RequestRejected):
                self.call(Operation.CLEAR_FAULT)

    def go(self) -> None:
        """Somebody has the scan taken up, whatever ended it, and the keeper keep it."""
        if self.host.assembly is None:  # a host that never got to know the plan must not start it
            self.new_host()
        self.clear()
        if self.host.device_state not in RUNNING:
            self.stopped_at = None
            self.keeper.resume(self.plan, self.host_now)
            self.until(lambda: not self.keeper.busy or self.host.failure, 20_000)
            if self.keeper.refusal is not None:
                raise self.keeper.refusal

    def abort(self, level: AbortLevel) -> None:
        self.keeper.release()
        self.stopped_at = self.device_now
        self.host.abort(level, self.clock.now())

    def reboot(self, milliseconds: int) -> None:
        self.boots += 1
        self.dark_until = self.device_now + milliseconds * 1000
        self.permission = 0
        self.device = self.boot(0xB006 + self.boots * 0x101)

    def unplug(self, milliseconds: int) -> None:
        if not self.plugged_out:
            self.plugged_out, self.back_at = True, self.clock.now() + milliseconds * 1000
            self.host.link_lost()
            self.up._queue.clear()
            self.down._queue.clear()

    def kill_host(self) -> None:
        self.host_alive, self.memory = False, []

    def new_host(self) -> None:
        """A new process: it knows the plan and its disk."""
        self.nonce += 1
        self.kill_host()
        self.host, self.host_alive, self.hung, self.plugged_out = Host(self.nonce), True, False, False
        self.keeper = ScanRecovery(self.host, RecoveryPolicy(patience=1e9))
        self.connect()
        self.clear()
        status = self.host.status
        if status.plan == self.plan.uid and status.acknowledged <= len(self.disk):
            self.until(lambda: self.host.plan_status is not None, 5_000)
            assert self.host.resume_plan(self.plan, self.clock.now(), len(self.disk))
        else:
            self.call_upload()

    def calm(self) -> None:
        """Take all faults away."""
        for line in (self.up, self.down):
            line.filters[:] = [item for item in line.filters if item is self.recorder]
        self.hung = self.disk_full = False
        self.back_at = 0

    def finish(self, limit_ms: int = 120_000) -> None:
        """Calm down, and have the operator do what it takes; then everything must be there exactly once."""
        self.calm()
        start = self.clock.now()
        while len(self.disk) < self.count:
            assert self.clock.now() - start < limit_ms * 1000, f"stuck: {self.host.state}, {self.device.state}"
            self.run(50)
            try:
                if not self.host_alive or self.host.failure is not None:
                    self.new_host()
                if not self.keeper.is_recovering and (self.keeper.waiting or self.host.device_state in HALTED):
                    self.keeper.disable()  # stopped by somebody, be it by an old ABORT that was replayed, or for long
                idle = self.host.device_state not in RUNNING | {DeviceState.DRAINING, DeviceState.DONE}
                if not self.keeper.engaged and idle and not self.host.aborting:
                    self.go()
            except ScannerError:
                continue
        self.keeper.release()
        self.run(300)
        assert sorted(self.disk) == list(range(self.count))
        assert len(self.instrument.log) >= self.count
