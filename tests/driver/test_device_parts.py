"""The device's parts alone: transition table, lease, ring, plan memory, replies."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fabry_perot.device.lease import LaserLease
from fabry_perot.device.planbuffer import PlanBuffer
from fabry_perot.device.replies import ReplyCache
from fabry_perot.device.ring import ALineRing
from fabry_perot.messages import POINT
from fabry_perot.states import RUNNING, TRANSITIONS, DeviceState, Event

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
def test_a_running_scan_goes_to_safe_hold_whatever_it_waits_for(state, event):
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
    assert lease.until == min(echo, now) + min(ttl, 1_000_000)
    assert lease.permits(now) == (now < lease.until)


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
    ring = ALineRing(2)
    ring.append(0, b"a")
    ring.append(1, b"b")
    with pytest.raises(OverflowError):
        ring.append(2, b"c")
    ring.acknowledge(1, 10, [])
    ring.append(2, b"c")
    assert (ring.acknowledged, ring.produced, ring.fill) == (1, 3, 2)


def test_the_ring_ignores_an_acknowledgement_of_what_was_never_produced():
    ring = ALineRing(2)
    ring.append(0, b"a")
    ring.acknowledge(5, 10, [(7, 0xFF)])
    assert ring.fill == 1
    assert ring.next_payload(100) is None, "no credit was granted by it either"


def test_the_ring_sends_nothing_beyond_the_hosts_credit():
    ring = ALineRing(8)
    for index in range(5):
        ring.append(index, b"x")
    ring.acknowledge(0, 2, [])
    sent = [ring.next_payload(100) for _ in range(5)]
    assert [item is not None for item in sent] == [True, True, False, False, False]


def test_points_with_a_gap_before_them_are_not_accepted():
    plan = PlanBuffer(10)
    plan.begin(1, 20)
    points = np.zeros(4, POINT)
    assert len(plan.accept(2, points)) == 0
    assert len(plan.accept(0, points)) == 4
    assert len(plan.accept(2, points)) == 2, "an overlap adds only what is new"
    assert len(plan.accept(6, np.zeros(10, POINT))) == 4, "no more than the memory holds"
    plan.position = 3
    assert plan.limit == 13


def test_old_request_ids_are_stale_once_their_reply_is_forgotten():
    cache = ReplyCache(size=2)
    for number in (1, 2, 3):
        cache.store(number, b"%d" % number)
    assert cache.find(3) == b"3"
    assert cache.find(1) is None
    assert cache.stale(1)
    assert not cache.stale(4)
