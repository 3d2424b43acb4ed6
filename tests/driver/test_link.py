"""Whole scans between the real host and the real device over a line that misbehaves, under a virtual clock."""

from __future__ import annotations

import pytest

from fabry_perot.errors import RequestRejected
from fabry_perot.wire.constants import Operation, Type
from fabry_perot.wire.framing import Deframer, Frame, encode_frame
from fabry_perot.wire.messages import pack_body
from fabry_perot.wire.states import RUNNING, DeviceState


def test_a_clean_scan_delivers_every_a_line_once_bit_exact(bench):
    bench.scan(50)
    bench.finish()
    bench.check_exact(50)
    assert bench.device.scan.shots == 50 == len(bench.instrument.log)


def test_a_lines_larger_than_a_frame_are_cut_and_joined(make_bench):
    bench = make_bench(max_payload=641)
    bench.scan(10, samples=4096)
    bench.finish()
    bench.check_exact(10)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("payload", [641, 8192])
def test_bit_errors_both_ways_cost_time_but_no_data(make_bench, faults, seed, payload):
    bench = make_bench(max_payload=payload)
    bench.scan(60, samples=700)
    bench.down.filters.append(faults.bit_flips(seed, 1e-5))
    bench.up.filters.append(faults.bit_flips(seed + 100, 1e-4))
    bench.finish_with_resumes()
    bench.check_exact(60)
    assert bench.host.deframer.counters.bad > 0


@pytest.mark.parametrize("seed", range(3))
def test_lost_inserted_and_doubled_bytes_cost_no_data(make_bench, faults, seed):
    bench = make_bench(max_payload=641)
    bench.scan(60, samples=700)
    bench.down.filters.append(faults.byte_loss(seed, 4000))
    bench.up.filters.append(faults.byte_loss(seed + 100, 400))
    bench.finish_with_resumes()
    bench.check_exact(60)


@pytest.mark.parametrize("nth", [0, 7, 49])
def test_a_lost_a_line_frame_is_asked_for_and_comes_again_even_the_last_one(bench, faults, nth):
    bench.down.filters.append(faults.drop(Type.ALINE, lambda n: n == nth))
    bench.scan(50)
    bench.finish()
    bench.check_exact(50)
    assert len(bench.instrument.log) == 50, "repair must not fire again"


def test_duplicated_a_lines_are_delivered_once(bench, faults):
    bench.down.filters.append(faults.drop(Type.ALINE, lambda n: True, copies=2))
    bench.scan(30)
    bench.finish()
    bench.check_exact(30)
    assert bench.host.assembly.duplicates == 30


def test_lost_acknowledgements_are_repaired_by_later_ones(bench, faults):
    bench.up.filters.append(faults.drop(Type.ALINE_ACK, lambda n: n % 3 != 2))
    bench.scan(60)
    bench.finish()
    bench.check_exact(60)


@pytest.mark.parametrize("kind", [Type.HELLO, Type.CAPS, Type.REQ, Type.PLAN_DATA, Type.LEASE])
def test_the_first_frame_of_any_kind_from_the_host_may_be_lost(bench, faults, kind):
    bench.up.filters.append(faults.drop(kind, lambda n: n == 0))
    bench.scan(20)
    bench.finish()
    bench.check_exact(20)


@pytest.mark.parametrize("kind", [Type.HELLO_ACK, Type.CAPS_PIECE, Type.RSP, Type.PLAN_STATUS, Type.STATUS])
def test_the_first_frame_of_any_kind_from_the_device_may_be_lost(bench, faults, kind):
    bench.down.filters.append(faults.drop(kind, lambda n: n == 0))
    bench.scan(20)
    bench.finish()
    bench.check_exact(20)


def test_a_plan_longer_than_the_devices_memory_is_uploaded_while_scanning(make_bench, faults):
    bench = make_bench(plan_points=16)
    bench.up.filters.append(faults.drop(Type.PLAN_DATA, lambda n: n % 4 == 1))
    bench.scan(100)
    bench.finish()
    bench.check_exact(100)
    assert [point for _, point, _ in bench.instrument.log] == list(range(100))


def test_a_new_plan_reports_the_purged_a_lines_as_gone(bench):
    bench.acknowledging = False
    bench.scan(20)
    bench.until(lambda: len(bench.stored) == 20)
    bench.upload(5)
    bench.run(10)
    assert bench.host.gone == 20


@pytest.mark.long
def test_points_outside_the_devices_limits_are_refused_by_the_device_itself(bench):
    bench.connect()
    with pytest.raises(AssertionError, match="not reached"):
        bench.upload(3, averages=101)
    assert bench.host.uploader.refused
    assert bench.device.plan.expected == 0


def test_unknown_and_malformed_requests_are_answered_and_change_nothing(bench):
    bench.connect()
    with pytest.raises(RequestRejected, match="malformed"):
        bench.call(Operation.PLAN_NEW, plan="x")
    with pytest.raises(RequestRejected, match="out-of-range"):
        bench.call(Operation.PLAN_NEW, plan=1, length=1, samples=9000, interval_ps=8000, pulse_rate_mhz=50_000)
    with pytest.raises(RequestRejected, match="malformed"):
        bench.call(Operation.TUNE_SCAN)
    with pytest.raises(RequestRejected, match="colour"):
        bench.call(Operation.SET, colour=1)
    assert bench.device.state is DeviceState.LINKED


def test_random_payloads_of_every_type_with_valid_checksums_crash_neither_side(bench):
    import random

    bench.scan(2000)
    bench.run(100)
    source = random.Random(5)
    for _ in range(3000):
        payload = source.randbytes(source.choice([0, 1, 5, 12, 13, 16, 17, 40, 52, 74, 90]))
        if source.random() < 0.2:
            payload = payload[:3] + pack_body({"token": source.randrange(99)})
        kind = source.choice([kind for kind in Type if kind not in (Type.HELLO, Type.ABORT)])
        frame = encode_frame(Frame(kind, 0, 0x07, bench.host.session, 0, payload))
        bench.device.receive(frame, bench.device_now)
        bench.host.receive(frame, bench.clock.now())
    assert all(bench.lease_ok)
    assert bench.device.state in RUNNING | {DeviceState.SAFE_HOLD, DeviceState.PAUSED, DeviceState.READY}


def test_the_device_falls_silent_without_a_session(bench):
    bench.run(500)
    assert Deframer().feed(bench.device.next_frames(10_000)) == []
