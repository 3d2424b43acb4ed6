"""A second implementation's view: a decoder written from PROTOCOL.md alone agrees with the driver on whole sessions."""

from __future__ import annotations

import struct

import driver_faults
import numpy as np
import pytest
from driver_bench import Bench, truth
from driver_reference import ALines, castagnoli, frames

from fabry_perot.host import WirePlan
from fabry_perot.simulator import line_faults
from fabry_perot.wire.constants import Type
from fabry_perot.wire.encoding import Encoding
from fabry_perot.wire.framing import Deframer
from fabry_perot.wire.messages import POINT


def record(encoding: int, *, noisy: bool) -> tuple[Bench, bytes, bytes]:
    bench = Bench(max_payload=641)
    up, down = driver_faults.Recorder(), driver_faults.Recorder()
    if noisy:
        bench.down.filters.append(line_faults.BitFlips(3, 2e-5))
        bench.up.filters.append(driver_faults.ByteFaults(4, 2000))
    bench.up.filters.append(up)
    bench.down.filters.append(down)
    bench.connect()
    points = np.zeros(30, POINT)
    points["averages"] = 1
    plan = WirePlan(points, 500, 8000, 200_000, encoding)
    call = bench.host.upload(plan, bench.clock.now())
    bench.until(lambda: call.done and bench.device.state.name == "READY")
    bench.start()
    bench.finish_with_resumes()
    return bench, up.data, down.data


@pytest.mark.parametrize("encoding", list(Encoding))
@pytest.mark.parametrize("noisy", [False, True])
def test_both_read_the_same_frames_and_the_same_samples(encoding, noisy):
    bench, up, down = record(encoding, noisy=noisy)
    for data in (up, down):
        ours = [(f.type, f.boot, f.session, f.sequence, f.payload) for f in Deframer().feed(data + b"\0")]
        theirs = [(f["type"], f["boot"], f["session"], f["sequence"], f["payload"]) for f in frames(data)]
        assert ours == theirs
    reader = ALines()
    for frame in frames(down):
        reader.take(frame)
    (plan,) = {plan for plan, _ in reader.lines}
    assert sorted(number for _, number in reader.lines) == list(range(30))
    for line in bench.stored:
        other = reader.lines[plan, line.number]
        assert other["values"] == line.samples.tolist() == truth(line.point, 500).tolist()
        assert (other["shot"], other["point"]) == (line.shot, line.point)
        assert other["fire"] * 1e-6 == pytest.approx(line.fire_time_s)
        assert other["scale"] == line.scale


def test_the_second_reader_finds_state_and_counters_in_status_where_the_document_puts_them():
    bench, _, down = record(0, noisy=False)
    last = [frame for frame in frames(down) if frame["type"] == 0xB0][-1]["payload"]
    time, boot, state, _laser, _cause, fault = struct.unpack_from("<QIBBBB", last)
    produced, sent, acknowledged, shots = struct.unpack_from("<4I", last, 26)
    assert (boot, state, fault) == (0xB007, 9, 0)
    assert (produced, sent, acknowledged, shots) == (30, 30, 30, 30)
    assert time <= bench.device_now


def test_the_second_readers_checksum_is_castagnolis():
    assert castagnoli(b"123456789") == 0xE3069283


def test_a_lines_that_wait_share_frames_which_the_second_reader_takes_apart_and_a_lost_one_costs_none_of_them():
    bench = Bench(max_payload=8192)
    bench.instrument.moving = 0
    recorder = driver_faults.Recorder()
    bench.down.filters += [recorder, driver_faults.FramesOfType(Type.ALINE, lambda count: count == 3)]
    bench.scan(60, samples=500, rate=5000.0)
    bench.finish()
    bench.check_exact(60)
    shared = [f["payload"][15] for f in frames(recorder.data) if f["type"] == Type.ALINE]
    assert max(shared) >= 3, "5 A-lines come up in the ms between two looks at the line"
    assert len(shared) < 40
    reader = ALines()
    for frame in frames(recorder.data):
        reader.take(frame)
    (plan,) = {plan for plan, _ in reader.lines}
    for number in range(60):
        assert reader.lines[plan, number]["point"] == number
        assert reader.lines[plan, number]["values"] == truth(number, 500).tolist()
    assert bench.host.assembly.repairs >= max(1, shared[3] + 1)
