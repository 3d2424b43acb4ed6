"""The scan itself: move, wait for the laser's pulse, fire, record; one step at a time."""

from __future__ import annotations

from collections.abc import Callable

from fabry_perot.device.lease import LaserLease
from fabry_perot.device.planbuffer import PlanBuffer
from fabry_perot.device.ring import ALineRing
from fabry_perot.hardware.instrument import Instrument, Interrogation, Sampling
from fabry_perot.wire.encoding import encode
from fabry_perot.wire.framing import crc32c
from fabry_perot.wire.messages import ALineMeta, pack
from fabry_perot.wire.states import RUNNING, DeviceState, Event

LATE_PULSE = 1_000
"""A pulse slot missed by more than this many µs is skipped, as a free-running laser would."""


class Scan:
    """Drives the instrument through the plan while the device's state allows it.

    Parameters
    ----------
    instrument, plan, ring, lease
        What it works with.
    state, step
        Read the device's state; move it by an event.
    """

    def __init__(
        self,
        instrument: Instrument,
        plan: PlanBuffer,
        ring: ALineRing,
        lease: LaserLease,
        state: Callable[[], DeviceState],
        step: Callable[[Event], None],
    ) -> None:
        self._instrument, self._plan, self._ring, self._lease = instrument, plan, ring, lease
        self._state, self._step = state, step
        self.sampling = Sampling(0, 0, 0)
        self.encoding = 0
        self.shots = 0
        self.shots_wasted = 0
        self.last_shot = 0
        self.reset()

    def reset(self) -> None:
        """Forget an unfinished point: it will be moved to and fired again from its first shot."""
        self.shots_wasted += getattr(self, "_fired", 0)
        self._fired = 0
        self._settled: int | None = None
        self.due: int | None = None
        self._instrument.drop()

    def advance(self, now: int) -> None:
        """Do everything that is due at ``now``; afterwards :attr:`due` says when to come again."""
        while self._state() in RUNNING and self._prepare(now):
            due = self.due if self.due is not None else now
            if now < due:
                return
            if now - due > LATE_PULSE:
                self.due = self._instrument.next_pulse(now)
                continue
            if not self._lease.permits(now):
                return
            self._fire(now)
        if self._state() not in RUNNING or self._settled is None:
            self.due = None

    def _prepare(self, now: int) -> bool:
        """Bring the state in line with plan and ring; return whether a shot is scheduled."""
        state = self._state()
        if self._plan.position >= self._plan.length:
            self._step(Event.LAST_POINT_FIRED)
            return False
        if self._ring.full:
            if state is DeviceState.SCANNING:
                self._step(Event.RING_FULL)
            return False
        if state is DeviceState.BLOCKED:
            self._step(Event.RING_FREED)
        if not self._plan.at_hand:
            if self._state() is DeviceState.SCANNING:
                self._step(Event.POINTS_SHORT)
            return False
        if self._state() is DeviceState.STARVED:
            self._step(Event.POINTS_AT_HAND)
        if self._settled is None:
            settle = int(self._plan.current()["settle"]) * 100
            self._settled = self._instrument.move(self._plan.position, now) + settle
            self.due = self._instrument.next_pulse(max(self._settled, self.last_shot + 1))
        return True

    def _fire(self, now: int) -> None:
        index = self._plan.position
        self.shots += 1
        self.last_shot = now
        self._fired += 1
        self._instrument.fire(index, self.shots, now)
        if self._fired < max(1, int(self._plan.current()["averages"])):
            self.due = self._instrument.next_pulse(now + 1)
            return
        taken = self._instrument.read(index)
        used, data = encode(taken.samples, self.encoding)
        self._ring.append(index, self._meta(taken, now) + data, used)
        self._plan.position += 1
        self._fired, self._settled, self.due = 0, None, None

    def _meta(self, taken: Interrogation, now: int) -> bytes:
        meta = ALineMeta(
            fire_time=now,
            wavelength=taken.wavelength,
            shot=self.shots,
            crc=crc32c(taken.samples.astype("<i2", copy=False).tobytes()),
            scale=taken.scale,
            interval=self.sampling.interval_ps,
            samples=len(taken.samples),
            averages=self._fired,
            energy=min(taken.energy, 0xFFFF),
            dc=taken.dc,
            gain=taken.gain,
            quality=taken.quality,
            time_zero=taken.time_zero,
        )
        return pack(meta)
