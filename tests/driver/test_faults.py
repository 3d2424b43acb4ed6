"""The line's faults do what they say: a test that trusts them would otherwise prove nothing."""

from __future__ import annotations

import random

import driver_faults
import pytest

from fabry_perot.simulator import line_faults
from fabry_perot.wire.framing import Deframer, Frame, encode_frame

DATA = random.Random(0).randbytes(40_000)
FRAMES = [Frame(kind, 0, 7, 9, count, bytes([count] * 20)) for count in range(40) for kind in (0x30, 0x31)]
LINE = b"".join(map(encode_frame, FRAMES))


def pieces(data: bytes, size: int = 97) -> list[bytes]:
    return [data[at : at + size] for at in range(0, len(data), size)]


def through(item: line_faults.Filter, data: bytes, now: int = 0) -> bytes:
    return b"".join(item(piece, now) for piece in pieces(data))


def test_bit_flips_come_at_their_rate_and_the_same_ones_for_the_same_seed():
    changed = through(line_faults.BitFlips(1, 1e-3), DATA)
    count = sum((a ^ b).bit_count() for a, b in zip(DATA, changed, strict=True))
    assert 240 < count < 400
    assert changed == through(line_faults.BitFlips(1, 1e-3), DATA) != through(line_faults.BitFlips(2, 1e-3), DATA)
    assert through(line_faults.BitFlips(1, 0.0), DATA) == DATA


def test_byte_faults_drop_insert_and_double():
    changed = through(driver_faults.ByteFaults(3, 500), DATA)
    assert changed != DATA
    assert abs(len(changed) - len(DATA)) < 60


def test_whole_pieces_come_twice_or_too_late_but_are_never_lost():
    item, parts = driver_faults.ChunkFaults(5, 4), pieces(DATA)
    out = [item(part, 0) for part in parts]
    assert any(piece == part + part for piece, part in zip(out, parts, strict=True))
    assert any(piece == late + early for piece, early, late in zip(out[1:], parts, parts[1:], strict=False))
    assert all(part in b"".join(out) for part in parts[:-1])
    assert item(b"", 0) == b""


def test_a_stall_gives_up_everything_at_its_end_and_a_cut_nothing():
    stall, cut = line_faults.Delay(100, 200), line_faults.DropAll(100, 200)
    assert (stall(b"a", 99), stall(b"b", 100), stall(b"c", 199), stall(b"d", 200), stall(b"", 300)) == (
        b"a",
        b"",
        b"",
        b"bcd",
        b"",
    )
    assert (cut(b"a", 99), cut(b"b", 150), cut(b"c", 200)) == (b"a", b"", b"c")


def test_fault_slow_reader_limits_rate_and_preserves_order():
    item = driver_faults.SlowReader(1_000.0)
    out = [item(DATA[:100] if step == 0 else b"", 10_000 * step) for step in range(12)]
    assert b"".join(out) == DATA[:100]
    assert [len(part) for part in out[1:11]] == [10] * 10


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_frames_are_lost_whole_and_at_their_share(share):
    left = Deframer().feed(through(line_faults.FrameLoss(1, share), LINE))
    assert [frame for frame in FRAMES if frame in left] == left
    assert abs(len(left) - (1 - share) * len(FRAMES)) <= 12 * (0 < share < 1)


@pytest.mark.parametrize("copies", [0, 2])
def test_a_frame_of_a_type_is_lost_or_doubled_by_its_count(copies):
    item = driver_faults.FramesOfType(0x31, lambda count: count == 3, copies=copies)
    left = Deframer().feed(through(item, LINE))
    assert [left.count(frame) for frame in FRAMES] == [copies if frame == FRAMES[7] else 1 for frame in FRAMES]
    assert item.seen == 40


def test_fault_recorder_keeps_tail_and_replay_inserts_it_once():
    recorder = driver_faults.Recorder(50)
    assert through(recorder, DATA) == DATA
    assert recorder.data == DATA[-50:]
    replay = driver_faults.Replay(recorder.data, 100)
    assert (replay(b"a", 99), replay(b"b", 100), replay(b"c", 101)) == (b"a", DATA[-50:] + b"b", b"c")


def test_a_chain_passes_through_all_of_them_in_order():
    chain = line_faults.FilterChain([line_faults.DropAll(0, 10), driver_faults.Recorder()])
    chain.filters.append(recorder := driver_faults.Recorder())
    assert chain(b"a", 5) == b""
    assert chain(b"b", 10) == recorder.data == b"b"
