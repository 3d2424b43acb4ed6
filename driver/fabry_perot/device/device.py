"""Device state machine without I/O: receives bytes and time, returns bytes."""

from __future__ import annotations

from fabry_perot.device.device_state import DeviceBody
from fabry_perot.device.message_handlers import HANDLERS
from fabry_perot.errors import FrameError
from fabry_perot.hardware.instrument import InstrumentError
from fabry_perot.wire.constants import Result, Type
from fabry_perot.wire.messages import Fault, pack
from fabry_perot.wire.states import RUNNING, DeviceState, Event

_SESSIONLESS = frozenset({Type.HELLO, Type.ABORT})


class Device(DeviceBody):
    """Firmware of a Fabry–Pérot scanner; parameters as of :class:`~fabry_perot.device.device_state.DeviceBody`.

    Call :meth:`receive` with bytes as they come, :meth:`poll` when :meth:`next_deadline` says so, and
    :meth:`next_frames` to get the bytes to send. Nothing here waits, reads a clock or touches hardware other than the
    injected instrument.
    """

    def receive(self, data: bytes, now: int) -> None:
        """Process bytes received at device time ``now``."""
        self.now = max(self.now, now)
        for frame in self.deframer.feed(data):
            mine = frame.session == self.outbox.session != 0 and frame.boot == self.boot & 0xFF
            handler = HANDLERS.get(frame.type)
            if handler is None or not (mine or frame.type in _SESSIONLESS):
                continue
            try:
                handler(self, frame)
            except FrameError:
                self.deframer.counters.bad_length += 1
            except InstrumentError as error:
                self.raise_fault(error.fault, str(error))
        self.poll(now)

    def poll(self, now: int) -> None:
        """Execute actions due at device time ``now``."""
        self.now = max(self.now, now)
        if self.state in RUNNING and not self.lease.permits(self.now):
            self.try_transition(Event.LEASE_LAPSED)
        if self.state is DeviceState.ARMED and self.now - self._armed_at >= self.timing.arm_timeout:
            self.try_transition(Event.ARM_EXPIRED)
        self.check_safety()
        self.hardware(lambda: self.scan.advance(self.now), None)
        if self.job is not None:
            self._look_after_job()
        if self.state is DeviceState.DRAINING and not self.ring.used:
            self.try_transition(Event.RING_EMPTY)
        if self.now >= self._status_at:
            self._status_due, self._status_at = True, self.now + self.timing.status_period
            self.plan_status_due |= self.plan.expected < self.plan.length
        if self.fault and self._fault_number and self.now >= self._fault_at:
            self._fault_at = self.now + self.timing.fault_period
            self.outbox.enqueue(Type.FAULT, pack(Fault(self.fault, self._fault_number)), urgent=True)

    def _look_after_job(self) -> None:
        try:
            levels = self.instrument.sweep_result(self.now)
        except InstrumentError as error:
            self.finish_sweep(Result.HARDWARE_FAULT)
            self.raise_fault(error.fault, str(error))
            return
        if levels is not None:
            self.finish_sweep(Result.OK, {"dc_mv": levels})

    def next_deadline(self) -> int:
        """Return the device time of the next action of :meth:`poll`."""
        due = [self._status_at]
        if self.state in RUNNING:
            due.append(self.lease.until)
            if self.scan.due is not None:
                due.append(self.scan.due)
        if self.state is DeviceState.ARMED:
            due.append(self._armed_at + self.timing.arm_timeout)
        if self.fault:
            due.append(self._fault_at)
        if self.job is not None:
            due.append(self.hardware(lambda: self.instrument.next_due(self.now), None) or self.now)
        return max(self.now, min(due))

    def next_frames(self, budget: int) -> bytes:
        """Return frames to send now, up to the one that reaches ``budget`` bytes; empty without frames."""
        parts: list[bytes] = []
        size = 0
        while size < budget:
            part = self._next_frame()
            if part is None:
                break
            parts.append(part)
            size += len(part)
        return b"".join(parts)

    def _next_frame(self) -> bytes | None:
        control = self.outbox.next_control()
        if control is not None:
            return control
        if not self.outbox.session:
            return None
        if self._status_due:
            self._status_due = False
            self._status_at = self.now + self.timing.status_period
            return self.outbox.frame(Type.STATUS, pack(self.status()))
        if self.plan_status_due:
            self.plan_status_due = False
            return self.outbox.frame(Type.PLAN_STATUS, pack(self.plan_status()))
        line = self.ring.next_payload(self.line_payload)
        return None if line is None else self.outbox.aline(*line)
