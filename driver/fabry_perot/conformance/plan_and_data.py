"""Conformance tests: plans, credit, ring buffer and retransmission."""

from __future__ import annotations

from fabry_perot.conformance.peer import QUIET_PERIOD, ConformanceHost, Failed
from fabry_perot.conformance.registry import ConformanceFunction, conformance_test
from fabry_perot.conformance.scan_helpers import RING_HEADROOM, many
from fabry_perot.host.aline import parse_record
from fabry_perot.wire.constants import ALL_FRAGMENTS, FLAG_FIDUCIAL, FLAG_GATE, MOST_BEAMS, Operation
from fabry_perot.wire.messages import ALineMeta, unpack
from fabry_perot.wire.states import DeviceState


@conformance_test("limits")
def limits(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """Plan parameters beyond the device's limits are rejected with the parameter's name; the plan is unchanged."""
    for name in ("samples", "interval_ps", "pulse_rate_mhz"):
        for value in (peer.limits[name][0] - 1, peer.limits[name][1] + 1):
            if 0 <= value < 1 << 32:
                reply = peer.request(Operation.PLAN_NEW, **peer.plan_new(4, **{name: value}))
                peer.expect((reply.result, reply.body.get("field")) == (2, name), f"result 2 and {name} for {value}")
    for changes, field in (({"plan": 0}, "plan"), ({"start": 4}, "start"), ({"encoding": 200}, "encoding")):
        reply = peer.request(Operation.PLAN_NEW, **peer.plan_new(4, **changes))
        peer.expect((reply.result, reply.body.get("field")) == (2, field), f"result 2 and {field} for {changes}")


@conformance_test("limits")
def out_of_range_points(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """A PLAN_DATA frame with points out of range is rejected as a whole."""
    peer.request_ok(Operation.PLAN_NEW, **peer.plan_new(4))
    points = peer.points(4)
    points["x"][2] = peer.limits["x_nm"][1] + 1
    peer.send_plan_data(points)
    peer.listen(QUIET_PERIOD)
    status = peer.plan_status
    peer.expect(status is not None and status.plan == peer.plan, "PLAN_STATUS")
    peer.expect(status is not None and (status.expected, status.retransmit & 2) == (0, 2), "none taken, bit 1 set")


@conformance_test("limits")
def beams(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """Plans with too many beams, or with a part of a place's beams, are rejected; plans with one beam are accepted."""
    has = int(peer.limits["beams"])
    peer.expect(1 <= has <= MOST_BEAMS, f"1 to {MOST_BEAMS} beams")
    offsets = peer.limits.get("beam_offsets_nm", [[0, 0]])
    peer.expect(len(offsets) == has and offsets[0] == [0, 0], f"where each of {has} beams is, the first at [0, 0]")
    for count, changes, field in ((2 * has + 2, {"beams": has + 1}, "beams"), (4, {"beams": 0}, "beams")):
        reply = peer.request(Operation.PLAN_NEW, **peer.plan_new(count, **changes))
        peer.expect((reply.result, reply.body.get("field")) == (2, field), f"result 2 and {field} for {changes}")
    if has > 1:
        reply = peer.request(Operation.PLAN_NEW, **peer.plan_new(has + 1, beams=has))
        peer.expect(
            (reply.result, reply.body.get("field")) == (2, "length"), f"result 2 and length for {has + 1} points"
        )
    peer.request_ok(Operation.PLAN_NEW, **peer.plan_new(3, beams=1))


@conformance_test("credit", fires=True)
def multi_beam_order(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """All beams record each shot, one A-line per beam in beam order; a plan may start between two beams."""
    has, places = int(peer.limits["beams"]), 3
    for start in sorted({0, has - 1}):
        before = peer.status.shots if peer.status else 0
        peer.upload(places * has, beams=has, start=start)
        peer.acknowledge(start, RING_HEADROOM)
        peer.start()
        count = places * has - start
        peer.wait(lambda count=count: len(peer.blobs()) >= count, 10.0)  # type: ignore[misc]
        blobs = peer.blobs()
        peer.expect(sorted(blobs) == list(range(start, places * has)), f"A-lines {start} … {places * has - 1}")
        metas = {number: unpack(ALineMeta, blob, tail=True) for number, blob in blobs.items()}
        fired = [{(metas[n].shot, metas[n].fire_time) for n in metas if n // has == place} for place in range(places)]
        peer.expect(all(len(shots) == 1 for shots in fired), "one shot number and fire time at each place")
        peer.expect(len(set.union(*fired)) == places, "another shot for each place")
        peer.acknowledge(places * has, RING_HEADROOM)
        peer.expect(peer.wait(lambda: peer.state is DeviceState.DONE, 2.0), "DONE when all is acknowledged")
        shots = int(peer.limits["averages"][0]) * places
        peer.expect(
            peer.status is not None and peer.status.shots - before == shots, f"{shots} shots for {places} places"
        )


@conformance_test("limits")
def gate(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """A device without a gate input rejects points that wait for the gate, and accepts other flags."""
    for flag, refused in ((FLAG_GATE, not peer.limits.get("gate", False)), (FLAG_FIDUCIAL, False)):
        peer.request_ok(Operation.PLAN_NEW, **peer.plan_new(2))
        points = peer.points(2)
        points["flags"][1] = flag
        peer.send_plan_data(points)
        peer.listen(QUIET_PERIOD)
        status = peer.plan_status
        peer.expect(status is not None and status.plan == peer.plan, "PLAN_STATUS")
        said = None if status is None else (status.expected, status.retransmit & 2)
        word, expected = ("refused", (0, 2)) if refused else ("taken", (2, 0))
        peer.expect(said == expected, f"two points {word}, the second with flag {flag}")


@conformance_test("credit")
def plan_gaps(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """Points after a gap in the plan are not stored until the gap is filled; overlapping points are harmless."""
    peer.request_ok(Operation.PLAN_NEW, **peer.plan_new(8))
    points = peer.points(8)

    def expected() -> int:
        peer.listen(QUIET_PERIOD)
        return peer.plan_status.expected if peer.plan_status and peer.plan_status.plan == peer.plan else -1

    peer.send_plan_data(points[4:], 4)
    peer.expect(expected() == 0, "point 0 expected after points 4 … 7")
    peer.send_plan_data(points[:3])
    peer.expect(expected() == 3, "point 3 expected after points 0 … 2")
    peer.send_plan_data(points[1:], 1)
    peer.expect(expected() == 8, "all points after an overlap")
    peer.expect(peer.state is DeviceState.READY, "READY with all points")


@conformance_test("credit", fires=True)
def credit(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """The device sends A-lines below the host's limit (credit) only."""
    peer.upload(many(peer))
    peer.start()
    peer.expect(peer.wait(lambda: peer.status is not None and peer.status.produced >= 6, 5.0), "six A-lines fired")
    peer.expect(not peer.fragments, "no A-line without credit")
    peer.acknowledge(0, 3)
    peer.listen(QUIET_PERIOD)
    peer.expect(sorted(peer.blobs()) == [0, 1, 2], f"A-lines 0, 1, 2 with a limit of 3, not {sorted(peer.blobs())}")


@conformance_test("credit", fires=True)
def full_ring(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """A full ring buffer stops the laser without overwriting A-lines; the scan continues when space is freed."""
    assert peer.hello is not None  # noqa: S101
    ring = peer.hello.ring
    peer.upload(ring + 40)
    peer.start()
    rate = peer.pulse_rate * 1e-3 * peer.rate
    peer.wait(lambda: peer.state is DeviceState.BLOCKED, 10 + 2 * ring / rate)
    peer.expect(peer.state is DeviceState.BLOCKED, f"BLOCKED with {ring} A-lines unacknowledged")
    peer.listen(QUIET_PERIOD)
    status = peer.status
    peer.expect(status is not None and (status.produced, status.acknowledged) == (ring, 0), f"{ring} held, none freed")
    peer.acknowledge(0, 1)
    peer.expect(peer.wait(lambda: 0 in peer.blobs(), 2.0), "A-line 0, which was not overwritten")
    peer.acknowledge(1, 1)
    more = peer.wait(lambda: peer.status is not None and peer.status.produced == ring + 1, 3.0)
    peer.expect(more, "one more A-line for the one that was freed")


@conformance_test("repair", fires=True)
def retransmission(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """A-lines that the host requests again are sent with the same bytes and the retransmission flag."""
    peer.upload(6)
    peer.acknowledge(0, RING_HEADROOM)
    peer.start()
    peer.expect(peer.wait(lambda: len(peer.blobs()) == 6, 10.0), "all six A-lines")
    before = peer.blobs()
    for number, blob in before.items():
        _readable(peer, number, blob)
    peer.fragments.clear()
    peer.acknowledge(2, RING_HEADROOM, (1, ALL_FRAGMENTS), (3, ALL_FRAGMENTS), (5, 0))
    peer.expect(peer.wait(lambda: {3, 5} <= set(peer.fragments), 2.0), "A-lines 3 and 5 again")
    peer.wait(lambda: 3 in peer.blobs(), 1.0)
    peer.expect(1 not in peer.fragments, "A-line 1 not again, since it is stored")
    peer.expect({3, 5} <= peer.again, "the flag of a retransmission on what comes again")
    peer.expect(peer.blobs().get(3) == before[3], "the same bytes again")
    peer.acknowledge(6, RING_HEADROOM)
    peer.expect(peer.wait(lambda: peer.state is DeviceState.DONE, 2.0), "DONE when all is acknowledged")


@conformance_test("repair", fires=True)
def redelivery_after_session(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """After a new session, the device resends all unacknowledged A-lines and no acknowledged ones."""
    peer.upload(6)
    peer.acknowledge(0, RING_HEADROOM)
    peer.start()
    peer.expect(peer.wait(lambda: len(peer.blobs()) == 6, 10.0), "all six A-lines")
    before = peer.blobs()
    peer.acknowledge(2, RING_HEADROOM)
    peer.expect(peer.wait(lambda: peer.status is not None and peer.status.acknowledged == 2, 2.0), "two acknowledged")
    peer.connect()
    peer.fragments.clear()
    peer.listen(QUIET_PERIOD)
    peer.expect(not peer.fragments, "no A-line in a new session before it grants credit")
    peer.acknowledge(2, RING_HEADROOM)
    peer.expect(peer.wait(lambda: len(peer.blobs()) == 4, 2.0), "A-lines 2 … 5 again")
    peer.expect(peer.blobs() == {number: before[number] for number in range(2, 6)}, "the same bytes")


def _readable(peer: ConformanceHost, number: int, blob: bytes) -> None:
    try:
        parse_record(blob, peer.fragments[number][-1][1])
    except ValueError as error:
        raise Failed(f"A-line {number}: {error}") from error
