"""Execution of a scan: moves points from the plan to the hardware, and records from the hardware to the ring buffer."""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np

from fabry_perot.device.lease import LaserLease
from fabry_perot.device.plan_buffer import PlanBuffer
from fabry_perot.device.ring_buffer import ALineRingBuffer
from fabry_perot.hardware.instrument import Instrument, InstrumentError, PlanSampling, PointRecord
from fabry_perot.wire.encoding import encode
from fabry_perot.wire.framing import crc32c
from fabry_perot.wire.messages import ALineMeta, pack
from fabry_perot.wire.states import RUNNING, DeviceState, Event

RECORD_FAULT = 9
"""Fault code: a record's figures are beyond what a message holds."""
LOOKAHEAD_POINTS = 64
"""Places the hardware has at a time."""


class Scan:
    """Scan in progress: executes the plan on the instrument while the device's state allows it.

    With several beams the points of a plan come as many at a time as there are beams, all at one place: point n is
    measured by beam n mod beams. The instrument is given the places.

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
        ring: ALineRingBuffer,
        lease: LaserLease,
        state: Callable[[], DeviceState],
        step: Callable[[Event], None],
    ) -> None:
        self._instrument, self._plan, self._ring, self._lease = instrument, plan, ring, lease
        self._state, self._step = state, step
        self.sampling = PlanSampling(0, 0, 0)
        self.encoding = 0
        self.shots = self.shots_wasted = self.last_shot = 0
        self._used = 0
        """Shots of which there is an A-line."""
        self._before = instrument.shots()
        """The laser's count when the device booted."""
        self._given = 0
        """Next point whose place is to be given to the instrument."""
        self._until = -1
        """How long it was last permitted to fire."""
        self.due: int | None = None

    def begin(self) -> None:
        """Start or restart the scan at the plan's position."""
        self._given, self._until = self._plan.position, -1

    def end(self, now: int) -> None:
        """Stop the instrument; an unfinished point is repeated from its first shot."""
        self.due = None
        try:
            self._instrument.stop(now)
            self._collect(now)
        finally:
            self.shots_wasted = self.shots - self._used

    def advance(self, now: int) -> None:
        """Execute all actions due at ``now``, and set :attr:`due` to the time of the next call."""
        if self._state() not in RUNNING:
            self.due = None
            return
        if self._lease.until != self._until:
            self._until = self._lease.until
            self._instrument.permit(self._until, now)
        while True:
            self._collect(now)
            if not self._feed(now):
                break
        self.due = self._instrument.next_due(now) if self._state() in RUNNING else None

    def _collect(self, now: int) -> None:
        """Move finished records from the instrument into the ring buffer."""
        for taken in self._instrument.poll(now):
            if taken.beam == 0:
                self._used += taken.averages
            point = taken.point * self.sampling.beams + taken.beam
            if point < self._plan.position:  # the host has this beam's A-line already, and asked for the others
                continue
            used, data = encode(taken.samples, self.encoding)
            self._ring.append(point, self._meta(taken) + data, used)
            self._plan.position = point + 1
        self.shots, self.last_shot = self._instrument.shots() - self._before, self._instrument.last_shot()

    def _feed(self, now: int) -> bool:
        """Pass more points to the instrument, or change the state if none are ready; return whether any were passed."""
        plan, under_way = self._plan, self._given - self._plan.position
        if plan.position >= plan.length:
            self._step(Event.LAST_POINT_FIRED)
            return False
        beams = self.sampling.beams
        next_place = beams - self._given % beams  # points until there: fewer, where a plan starts at one in between
        room = self._ring.free - under_way
        if room < next_place and not under_way:
            self._change(DeviceState.SCANNING, Event.RING_FULL)
            return False
        self._change(DeviceState.BLOCKED, Event.RING_FREED)
        count = min(room, LOOKAHEAD_POINTS * beams - under_way, plan.expected - self._given)
        count = (self._given + count) // beams * beams - self._given  # whole places
        if count <= 0:
            if not under_way:
                self._change(DeviceState.SCANNING, Event.POINTS_SHORT)
            return False
        self._change(DeviceState.STARVED, Event.POINTS_AT_HAND)
        places = plan.points(self._given, count)[np.r_[0, next_place:count:beams]]
        self._instrument.queue_points(self._given // beams, places, now)
        self._given += count
        return True

    def _change(self, state: DeviceState, event: Event) -> None:
        if self._state() is state:
            self._step(event)

    def _meta(self, taken: PointRecord) -> bytes:
        meta = ALineMeta(
            fire_time=taken.fire_time,
            wavelength=taken.wavelength,
            shot=taken.shot - self._before,
            crc=crc32c(taken.samples.astype("<i2", copy=False).tobytes()),
            scale=taken.scale,
            interval=self.sampling.interval_ps,
            samples=len(taken.samples),
            averages=taken.averages,
            energy=min(taken.energy, 0xFFFF),
            dc=taken.dc,
            gain=taken.gain,
            quality=taken.quality,
            time_zero=taken.time_zero,
        )
        try:
            return pack(meta)
        except struct.error as error:  # what the hardware says of itself does not fit in a message
            raise InstrumentError(RECORD_FAULT, f"A-line of point {taken.point}, {meta}: {error}") from error
