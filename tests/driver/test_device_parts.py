"""The device's parts alone: transition table, lease, ring, plan memory, replies."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fabry_perot.device.lease import LaserLease
from fabry_perot.device.plan_buffer import PlanBuffer
from fabry_perot.device.reply_cache import ReplyCache
from fabry_perot.device.request_handlers import execute
from fabry_perot.device.ring_buffer import ALineRingBuffer
from fabry_perot.device.transmit_queue import MAX_QUEUED, TransmitQueue
from fabry_perot.wire.constants import Operation, Result, Type
from fabry_perot.wire.framing import Deframer
from fabry_perot.wire.messages import LAYOUT, POINT, ALineHead
from fabry_perot.wire.states import RUNNING, TRANSITIONS, DeviceState, Event

S, E = DeviceState, Event


def test_scanning_is_entered_from_outside_only_by_start_from_armed():
    entries = {
        (state, event) for (state, event), after in TRANSITIONS.items() if after in RUNNING and state not in RUNNING
    }
    assert entries == {(S.ARMED, E.START)}


def test_armed_is_entered_only_by_an_explicit_arm():
    assert {event for (_, event), after in TRANSITIONS.items() if after is S.ARMED} == {E.ARM}


@pytest.mark.parametrize("state", [S.SAFE_HOLD, S.FAULT, S.ESTOP])
def test_no_safe_state_leads_back_to_an_armed_laser_in_one_step(state):
    after = {TRANSITIONS[pair] for pair in TRANSITIONS if pair[0] is state}
    assert not after & (RUNNING | {S.ARMED})


@pytest.mark.parametrize("state", sorted(RUNNING))
@pytest.mark.parametrize("event", [E.LEASE_LAPSED, E.NEW_SESSION, E.LASER_OFF])
def test_running_scan_lease_session_or_laser_loss_enters_safe_hold(state, event):
    assert TRANSITIONS[state, event] is S.SAFE_HOLD


@pytest.mark.parametrize("state", sorted(set(S) - {S.ESTOP}))
def test_an_emergency_stop_works_in_every_state(state):
    assert TRANSITIONS[state, E.EMERGENCY_STOP] is S.ESTOP


def test_a_latched_state_is_left_only_by_clearing_it():
    for state in (S.FAULT, S.ESTOP):
        leaving = {event for (before, event), after in TRANSITIONS.items() if before is state and after is not state}
        assert leaving - {E.EMERGENCY_STOP} == {E.CLEAR_FAULT}


def test_every_state_can_be_reached():
    reached, new = {S.BOOT}, {S.BOOT}
    while new:
        new = {after for (state, _), after in TRANSITIONS.items() if state in new} - reached
        reached |= new
    assert reached == set(S)


@given(
    echo=st.integers(0, 10_000_000),
    ttl=st.integers(0, 5_000_000),
    now=st.integers(0, 10_000_000),
)
def test_a_lease_never_outlives_the_echo_or_the_cap(echo, ttl, now):
    lease = LaserLease(cap=1_000_000)
    lease.renew(echo, ttl, now)
    proven = echo <= now
    assert lease.until == (echo + min(ttl, 1_000_000) if proven else 0)
    assert lease.permits(now) == (now < lease.until)
    assert lease.impossible == (not proven)


def test_an_older_renewal_arriving_late_shortens_nothing():
    lease = LaserLease(cap=1_000_000)
    lease.renew(1000, 500, 1000)
    lease.renew(900, 500, 1001)
    assert lease.until == 1500


def test_an_echo_from_before_the_present_session_counts_for_nothing():
    lease = LaserLease(cap=1_000_000)
    lease.revoke(2000)
    assert not lease.renew(1999, 500, 2001)
    assert lease.renew(2000, 500, 2001)


def test_the_ring_refuses_rather_than_overwrites():
    ring = ALineRingBuffer(2)
    ring.append(0, b"a")
    ring.append(1, b"b")
    with pytest.raises(OverflowError):
        ring.append(2, b"c")
    ring.acknowledge(1, 10, [])
    ring.append(2, b"c")
    assert (ring.acknowledged, ring.produced, ring.used) == (1, 3, 2)


def test_ring_acknowledgement_beyond_last_produced_is_ignored():
    ring = ALineRingBuffer(2)
    ring.append(0, b"a")
    ring.acknowledge(5, 10, [(7, 0xFF)])
    assert ring.used == 1
    assert ring.next_payload(100) is None, "no credit was granted by it either"


def test_the_ring_sends_nothing_beyond_the_hosts_credit():
    ring = ALineRingBuffer(8)
    for index in range(5):
        ring.append(index, b"x")
    ring.acknowledge(0, 2, [])
    sent = [ring.next_payload(100) for _ in range(5)]
    assert [item is not None for item in sent] == [True, True, False, False, False]


def test_points_with_a_gap_before_them_are_not_accepted():
    plan = PlanBuffer(10)
    plan.reset(1, 20)
    points = np.zeros(4, POINT)
    assert len(plan.accept(2, points)) == 0
    assert len(plan.accept(0, points)) == 4
    assert len(plan.accept(2, points)) == 2, "an overlap adds only what is new"
    assert len(plan.accept(6, np.zeros(10, POINT))) == 4, "no more than the memory holds"
    plan.position = 3
    assert plan.window_end == 13


def test_old_request_ids_are_stale_once_their_reply_is_forgotten():
    cache = ReplyCache(size=2)
    for number in (1, 2, 3):
        cache.store(number, b"%d" % number)
    assert cache.find(3) == b"3"
    assert cache.find(1) is None
    assert cache.stale(1)
    assert not cache.stale(4)


PLAN_NEW = {"plan": 1, "length": 4, "samples": 64, "interval_ps": 8000, "pulse_rate_mhz": 50_000, "purge": True}
SWEEP = {"x": 0, "y": 0, "from_pm": 1_500_000, "to_pm": 1_600_000, "steps": 11}


@pytest.mark.parametrize(
    ("operation", "good", "change", "field"),
    [
        (Operation.PLAN_NEW, PLAN_NEW, {"samples": 0}, "samples"),
        (Operation.PLAN_NEW, PLAN_NEW, {"interval_ps": 0}, "interval_ps"),
        (Operation.PLAN_NEW, PLAN_NEW, {"pulse_rate_mhz": 1 << 40}, "pulse_rate_mhz"),
        (Operation.PLAN_NEW, PLAN_NEW, {"plan": 0}, "plan"),
        (Operation.PLAN_NEW, PLAN_NEW, {"length": 0}, "length"),
        (Operation.PLAN_NEW, PLAN_NEW, {"start": 4}, "start"),
        (Operation.PLAN_NEW, PLAN_NEW, {"encoding": 7}, "encoding"),
        (Operation.PLAN_NEW, PLAN_NEW, {"group": 0}, "group"),
        (Operation.PLAN_NEW, PLAN_NEW, {"group": 256}, "group"),
        (Operation.SET, {"power": 1}, {"power": 11}, "power"),
        (Operation.TUNE_SCAN, SWEEP, {"x": 11_000_000}, "x"),
        (Operation.TUNE_SCAN, SWEEP, {"y": -11_000_000}, "y"),
        (Operation.TUNE_SCAN, SWEEP, {"to_pm": 1_500_000}, "to_pm"),
        (Operation.TUNE_SCAN, SWEEP, {"steps": 257}, "steps"),
    ],
)
def test_a_parameter_out_of_range_is_refused_by_its_name_and_changes_nothing(bench, operation, good, change, field):
    bench.connect()
    before = bench.device.statistics()
    result, body = execute(bench.device, operation, {**good, **change})
    assert (result, body) == (Result.OUT_OF_RANGE, {"field": field})
    assert bench.device.statistics() == before
    outcome = execute(bench.device, operation, good)
    assert outcome is None if operation is Operation.TUNE_SCAN else outcome[0] is Result.OK  # None: a sweep has begun


def test_device_conflicting_operations_during_scan_return_wrong_state(bench):
    bench.scan(50)
    bodies = {Operation.PLAN_NEW: PLAN_NEW, Operation.SET: {"power": 1}, Operation.TUNE_SCAN: SWEEP}
    for operation, body in bodies.items():
        assert execute(bench.device, operation, body)[0] is Result.WRONG_STATE
    for operation in (Operation.PARK, Operation.ARM, Operation.RELEASE, Operation.CLEAR_FAULT, Operation.START):
        body = {"token": 1, "echo": 1, "ttl": 1}
        assert execute(bench.device, operation, body)[0] is Result.WRONG_STATE
    bench.finish()
    bench.check_exact(50)


def test_a_plan_is_not_replaced_without_purge_while_a_lines_of_it_are_held(bench):
    bench.acknowledging = False
    bench.scan(20)
    bench.until(lambda: len(bench.stored) == 20)
    assert execute(bench.device, Operation.PLAN_NEW, {**PLAN_NEW, "purge": False}) == (Result.RING_NOT_EMPTY, {})
    assert bench.device.ring.used == 20


def test_device_unsupported_and_unknown_operations_are_rejected(bench):
    bench.connect()
    bench.device.limits["tuning_us"] = 0
    assert execute(bench.device, Operation.TUNE_SCAN, SWEEP)[0] is Result.NOT_SUPPORTED
    assert execute(bench.device, 99, {})[0] is Result.UNKNOWN_OPERATION


def test_device_late_poll_collects_hardware_triggered_shots(bench):
    bench.scan(50)
    bench.run(50)
    fired = len(bench.instrument.log)
    bench.device.poll(bench.device.now + 42_300)
    assert len(bench.instrument.log) == fired + 8, "a block goes on by the hardware's triggers, within the lease"
    bench.finish()
    assert all(time % 5_000 == 0 for time, _, _ in bench.instrument.log)
    bench.check_exact(50)


def test_the_scan_itself_asks_for_a_lease_before_each_shot(bench):
    bench.scan(50)
    fired, device = len(bench.instrument.log), bench.device
    device.lease.revoke(device.now)
    device.scan.advance(device.scan.due)
    assert device.state is DeviceState.SCANNING
    assert len(bench.instrument.log) == fired


def ring_of(*blobs: tuple[int, int, int], group: int = 255, limit: int = 99) -> ALineRingBuffer:
    """A ring holding A-lines given as (point, encoding, length of the blob)."""
    ring = ALineRingBuffer(32)
    ring.clear(9)
    ring.group = group
    ring.acknowledge(0, limit, [])
    for point, encoding, size in blobs:
        ring.append(point, bytes(size), encoding)
    return ring


def sent(ring: ALineRingBuffer, size: int = 1016) -> list[tuple[int, int, int, bool]]:
    """(number, fragments, A-lines in it, again) of all frames the ring has to send."""
    frames = []
    while (part := ring.next_payload(size)) is not None:
        head = ALineHead(*LAYOUT[ALineHead].unpack_from(part[0]))
        frames.append((head.number, head.fragments, head.more + 1, part[1]))
        assert len(part[0]) <= size
    return frames


PLAIN = [(point, 0, 100) for point in range(12)]


@pytest.mark.parametrize(
    ("ring", "frames"),
    [
        (ring_of(*PLAIN), [(0, 1, 10, False), (10, 1, 2, False)]),
        (ring_of(*PLAIN, group=5), [(0, 1, 5, False), (5, 1, 5, False), (10, 1, 2, False)]),
        (ring_of(*PLAIN, group=1), [(number, 1, 1, False) for number in range(12)]),
        (ring_of(*PLAIN, limit=7), [(0, 1, 7, False)]),
        (ring_of((0, 0, 100), (1, 0, 100), (2, 0, 98), (3, 0, 98)), [(0, 1, 2, False), (2, 1, 2, False)]),
        (ring_of((0, 0, 100), (1, 1, 100), (2, 1, 100)), [(number, 1, 1, False) for number in range(3)]),
        (ring_of((0, 0, 100), (2, 0, 100)), [(0, 1, 1, False), (1, 1, 1, False)]),
        (ring_of((0, 0, 1001), (1, 0, 100)), [(0, 2, 1, False), (0, 2, 1, False), (1, 1, 1, False)]),
    ],
    ids=["payload", "group", "one", "credit", "length", "packed", "points", "long"],
)
def test_a_lines_share_a_frame_as_far_as_payload_group_credit_and_their_kind_allow(ring, frames):
    assert sent(ring) == frames


def test_ring_retransmits_requested_fragments_only_if_held():
    ring = ring_of(*PLAIN)
    sent(ring)
    ring.acknowledge(2, 99, [(1, 0xFF), (3, 0xFF), (4, 9), (5, 0), (5, 0), (6, 0xFF), (40, 0)])
    ring.acknowledge(6, 99, [])
    assert sent(ring) == [(6, 1, 1, True)]
    ring.acknowledge(6, 99, [(7, 9), (8, 0)])
    assert sent(ring) == [(8, 1, 1, True)]


def test_ring_acknowledgement_beyond_last_fired_is_ignored():
    ring = ring_of(*PLAIN)
    ring.acknowledge(13, 99, [])
    assert (ring.acknowledged, ring.used) == (0, 12)
    for _ in range(20):
        ring.append(0, b"")
    with pytest.raises(OverflowError):
        ring.append(0, b"")


def test_transmit_queue_sends_urgent_first_and_drops_newest_when_full():
    outbox = TransmitQueue(7)
    for count in range(MAX_QUEUED + 5):
        outbox.enqueue(Type.PLAN_STATUS, bytes([count]))
    outbox.enqueue(Type.FAULT, b"urgent", urgent=True)
    frames = []
    while (data := outbox.next_control()) is not None:
        frames += Deframer().feed(data)
    assert [frame.payload for frame in frames] == [b"urgent", *(bytes([count]) for count in range(MAX_QUEUED - 1))]
