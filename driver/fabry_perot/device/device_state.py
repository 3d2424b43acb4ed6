"""State of the device: plan, ring buffer, lease and hardware."""

from __future__ import annotations

import logging
import random
from collections.abc import Callable
from typing import Any, TypeVar

from fabry_perot import fault_codes
from fabry_perot.device.lease import LaserLease
from fabry_perot.device.plan_buffer import PlanBuffer
from fabry_perot.device.reply_cache import ReplyCache
from fabry_perot.device.ring_buffer import ALineRingBuffer
from fabry_perot.device.scan import Scan
from fabry_perot.device.timing import DeviceTiming
from fabry_perot.device.transmit_queue import TransmitQueue
from fabry_perot.hardware.instrument import Instrument, InstrumentError, PlanSampling
from fabry_perot.wire.constants import (
    FAULT_INTERLOCK,
    FAULT_KEY,
    FAULT_SHUTTER,
    INTERLOCK_CLOSED,
    KEY_ON,
    LASER_ARMED,
    LASER_EMITTING,
    SAFE_BITS,
    SHUTTER_OPEN,
    Operation,
    Result,
    Type,
)
from fabry_perot.wire.framing import OVERHEAD, USB_PAYLOAD, Deframer, crc32c
from fabry_perot.wire.messages import REPLY_HEAD, PlanStatus, Status, pack_body
from fabry_perot.wire.states import LATCHED_STATES, RUNNING, TRANSITIONS, DeviceState, Event, HoldCause

_CAUSES = {
    Event.LEASE_LAPSED: HoldCause.LEASE,
    Event.NEW_SESSION: HoldCause.SESSION,
    Event.LASER_OFF: HoldCause.REQUEST,
    Event.CLEAR_FAULT: HoldCause.CLEARED,
}
log = logging.getLogger("fabry_perot")
_HOLD_CAUSES = frozenset({DeviceState.SAFE_HOLD, DeviceState.PAUSED})
"""States of a scan that may go on: an interlock opened meanwhile is remembered."""
T = TypeVar("T")


class DeviceBody:
    """State of a device: plan, ring, lease, hardware; :class:`~fabry_perot.device.device.Device` adds line and time.

    Parameters
    ----------
    instrument
        Galvo, laser and digitiser.
    boot
        Boot id (u32, not 0), new at every start.
    now
        Device time at start, in µs.
    timing
        Time limits.
    ring, plan_points
        A-lines and points held.
    max_payload
        Largest payload this line carries, in bytes.
    reset_cause
        As reported in HELLO_ACK: 1 power-on, 2 watchdog, 3 brown-out.
    """

    def __init__(
        self,
        instrument: Instrument,
        *,
        boot: int,
        now: int = 0,
        timing: DeviceTiming | None = None,
        ring: int = 512,
        plan_points: int = 8192,
        max_payload: int = USB_PAYLOAD,
        reset_cause: int = 1,
    ) -> None:
        self.instrument, self.boot, self.now = instrument, boot, now
        self.timing = timing or DeviceTiming()
        self.reset_cause = reset_cause
        self.state, self.cause, self.fault, self.fault_text = DeviceState.BOOT, HoldCause.NONE, 0, ""
        self.plan, self.ring = PlanBuffer(plan_points), ALineRingBuffer(ring)
        self.lease = LaserLease(self.timing.lease_cap)
        self.scan = Scan(instrument, self.plan, self.ring, self.lease, lambda: self.state, self.transition)
        self.outbox, self.replies = TransmitQueue(boot & 0xFF), ReplyCache()
        self.deframer = Deframer()
        self.line_payload = self.max_payload = max_payload
        self.job: int | None = None
        """Number of the request whose sweep is under way; it is answered when that is over."""
        self.nonce: int | None = None
        self.token: int | None = None
        self.limits: dict[str, Any] = instrument.capabilities()
        self.caps = pack_body({**self.limits, "lease_cap_us": self.timing.lease_cap})
        self.caps_crc = crc32c(self.caps)
        self.plan_status_due = self.plan_refused = False
        # Tokens and sessions must differ between boots, they guard against stale bytes, not against an attacker.
        self._random = random.Random(boot)  # noqa: S311
        self._session = self._random.randrange(1, 0x10000)
        self._armed_at = self._status_at = self._fault_at = now
        self._status_due = False
        self._fault_number, self._logged_faults = 0, dict[int, str]()
        self._shut_at = now
        self.close()
        self.hardware(self._rest, None)
        self.try_transition(Event.SELF_TEST_PASSED)

    def check_safety(self) -> bool:
        """Check interlock, key and shutter, and latch violations as faults; return whether the laser may fire."""
        bits = self.hardware_bits()
        if bits & SAFE_BITS != SAFE_BITS:
            if self.state in RUNNING or self.state is DeviceState.ARMED:
                self.raise_fault(FAULT_KEY if bits & INTERLOCK_CLOSED else FAULT_INTERLOCK)
            elif self.state in _HOLD_CAUSES and self.cause is not HoldCause.INTERLOCK:
                self.cause, self._status_due = HoldCause.INTERLOCK, True
        light = bits & (SHUTTER_OPEN | LASER_EMITTING)
        if light and self.state not in RUNNING and self.now - self._shut_at >= self.timing.shutter:
            self.raise_fault(FAULT_SHUTTER)
            self.close()
        return bits & SAFE_BITS == SAFE_BITS and not self.fault

    def hardware(self, call: Callable[[], T], otherwise: T) -> T:
        """Call the hardware and return its result; on a hardware fault, latch the fault and return ``otherwise``."""
        try:
            return call()
        except InstrumentError as error:
            self.raise_fault(error.fault, str(error))
            return otherwise

    def _rest(self) -> None:
        """Stop hardware operations of an earlier boot and discard their results."""
        self.instrument.stop(self.now)
        self.instrument.poll(self.now)

    def close(self) -> None:
        """Close the shutter and stop emission."""
        self._shut_at = self.now
        self.hardware(self.instrument.close, None)

    def try_transition(self, event: Event) -> bool:
        """Make the state transition for ``event``, if the table allows it; return whether it does."""
        after = TRANSITIONS.get((self.state, event))
        if after is None:
            return False
        before, self.state = self.state, after
        if after is before:
            return True
        self._status_due = True
        left = before in RUNNING and after not in RUNNING
        if left and after is not DeviceState.DRAINING:
            self.lease.revoke(self.now)
        if after is DeviceState.SAFE_HOLD:
            self.cause = _CAUSES[event]
        elif after is not DeviceState.ARMED:
            self.cause = HoldCause.NONE
        if after is not DeviceState.ARMED:
            self.token = None
        if event is Event.CLEAR_FAULT:
            self.fault, self.fault_text = 0, ""
        if left or after in LATCHED_STATES or after is DeviceState.SAFE_HOLD:
            self.close()
        if left:
            self.hardware(lambda: self.scan.end(self.now), None)
        if after in LATCHED_STATES:
            self.finish_sweep(Result.WRONG_STATE)
        return True

    def finish_sweep(self, result: Result | None, body: dict[str, Any] | None = None) -> None:
        """Reply to the request whose sweep is in progress, if any; without a result the request is dropped."""
        number, self.job = self.job, None
        if number is None:
            return
        if result is not Result.OK:
            self.hardware(lambda: self.instrument.stop(self.now), None)
        if result is not None:
            self.reply(number, Operation.TUNE_SCAN, result, body or {})

    def reply(self, number: int, operation: int, result: Result, body: dict[str, Any]) -> None:
        """Reply to a request, and cache the reply for repetitions of the request."""
        reply = REPLY_HEAD.pack(number, operation, result, self.state) + pack_body(body)
        if result is not Result.STALE_REQUEST:
            self.replies.store(number, reply)
        self.outbox.enqueue(Type.RSP, reply)

    def transition(self, event: Event) -> None:
        """Make a state transition, which the table must allow."""
        if not self.try_transition(event):
            raise RuntimeError(f"no transition from {self.state.name} by {event.name}")

    def new_session(self, nonce: int) -> None:
        """Open a session: laser off, earlier requests and permissions invalid; plan and A-lines are retained."""
        self.try_transition(Event.NEW_SESSION)
        self.finish_sweep(None)
        self.nonce, self.token = nonce, None
        self._session = self._session % 0xFFFF + 1
        self.outbox.clear()
        self.outbox.session = self._session
        self.replies.clear()
        self.lease.revoke(self.now)
        self.ring.resend_all()
        self._status_due = True
        self.plan_status_due = self.plan.length > 0

    def issue_arm_token(self) -> int:
        """Return a fresh single-use arm token."""
        self._armed_at = self.now
        self.token = self._random.randrange(1, 1 << 32)
        return self.token

    def begin(self, sampling: PlanSampling, encoding: int) -> None:
        """Apply the parameters of a new plan."""
        self.scan.sampling, self.scan.encoding = sampling, encoding
        self.instrument.begin(sampling)
        self.plan_status_due, self.plan_refused = True, False

    def raise_fault(self, code: int, reason: str = "") -> None:
        """Latch a hardware fault and send it until acknowledged; later ones are logged once, but do not replace it."""
        is_new = self.try_transition(Event.HARDWARE_FAULT) or (self.state in LATCHED_STATES and not self.fault)
        if is_new:
            self._logged_faults.clear()
        if self._logged_faults.get(code) != reason:  # a stuck shutter is found at each poll
            self._logged_faults[code] = reason
            log.error("hardware fault: %s%s", fault_codes.by_code(code), f": {reason}" if reason else "")
        if is_new:
            self.fault, self.fault_text, self._fault_at = code, reason, self.now
            self._fault_number += 1

    def acknowledge_fault(self, number: int) -> None:
        """Stop sending fault ``number``, which the host has acknowledged."""
        if number == self._fault_number:
            self._fault_at = 1 << 62

    def plan_status(self) -> PlanStatus:
        """Return the present PLAN_STATUS message."""
        return PlanStatus(self.plan.plan, self.plan.expected, self.plan.window_end, int(self.plan_refused) << 1)

    def hardware_bits(self) -> int:
        """Return the hardware's part of STATUS's laser bits; unknown states are reported as the unsafe ones."""
        asked = (
            (LASER_EMITTING, self.instrument.emitting, True),
            (SHUTTER_OPEN, self.instrument.shutter_open, True),
            (INTERLOCK_CLOSED, self.instrument.interlock_closed, False),
            (KEY_ON, self.instrument.key_on, False),
        )
        return sum(bit for bit, read, worse in asked if self.hardware(read, worse))

    def laser_bits(self) -> int:
        """Return the laser bits of STATUS."""
        bits = self.hardware_bits()
        return bits | (LASER_ARMED if self.state in RUNNING or self.state is DeviceState.ARMED else 0)

    def status(self) -> Status:
        """Return the present STATUS message."""
        x, y = self.hardware(self.instrument.position, (0, 0))
        laser = self.laser_bits()  # first: what these calls may latch belongs into what follows
        return Status(
            device_time=self.now,
            boot=self.boot,
            state=self.state,
            laser=laser,
            cause=self.cause,
            fault=min(self.fault, 0xFF),
            lease_left=min(self.lease.remaining(self.now) // 1000, 0xFFFF),
            plan=self.plan.plan,
            position=self.plan.position,
            produced=self.ring.produced,
            sent=self.ring.sent,
            acknowledged=self.ring.acknowledged,
            shots=self.scan.shots,
            shots_wasted=self.scan.shots_wasted,
            last_shot=self.scan.last_shot,
            lease_until=self.lease.until,
            x=x,
            y=y,
            bad_frames=self.deframer.counters.bad,
        )

    def statistics(self) -> dict[str, Any]:
        """Return the device's counters for a GET request."""
        counters = self.deframer.counters
        return {
            **self.status()._asdict(),
            "good_frames": counters.good,
            "bad_crc": counters.bad_crc,
            "bad_length": counters.bad_length,
            "bad_stuffing": counters.bad_stuffing,
            "payload": self.line_payload,
            "overhead": OVERHEAD,
            "ring_peak": self.ring.peak,
            "laser_shots": self.instrument.shots(),
            "impossible_echoes": self.lease.impossible,
        }
