"""The host's A-line assembly alone."""

from __future__ import annotations

import numpy as np
import pytest

from fabry_perot.errors import FrameError
from fabry_perot.host.aline import META, ALineBatch, parse_record
from fabry_perot.host.reassembly import AlineReassembler
from fabry_perot.wire.framing import crc32c
from fabry_perot.wire.messages import LAYOUT, ALineHead, ALineMeta, pack

PLAN = 9


def blob(value: int = 7) -> bytes:
    data = np.full(8, value, "<i2").tobytes()
    return pack(ALineMeta(0, 0, 1, crc32c(data), 1.0, 8000, 8, 1, 10_000, 0, 0, 0, 0)) + data


def payload(number: int, *, plan: int = PLAN, fragment: int = 0, fragments: int = 1, data: bytes | None = None):
    return pack(ALineHead(plan, number, number, fragment, fragments, 0, 0)) + (blob() if data is None else data)


def test_lines_out_of_order_are_delivered_in_order_and_the_gap_is_asked_for_once_per_repeat_time():
    assembly = AlineReassembler(PLAN, 0, window=8, repeat=100)
    assembly.receive(payload(1))
    assert not assembly.pop_ready()
    assert assembly.missing(0) == [(0, 0xFF)]
    assert assembly.missing(50) == []
    assert assembly.missing(100) == [(0, 0xFF)]
    assembly.receive(payload(0))
    assert [line.number for line in assembly.pop_ready()] == [0, 1]
    assert not assembly.has_gaps


def test_only_the_missing_fragment_is_asked_for():
    assembly = AlineReassembler(PLAN, 0, window=8, repeat=100)
    data = blob()
    assembly.receive(payload(0, fragment=0, fragments=3, data=data[:20]))
    assembly.receive(payload(0, fragment=2, fragments=3, data=data[40:]))
    assembly.mark_sent(1)
    assert assembly.missing(0) == [(0, 1)]
    assembly.receive(payload(0, fragment=1, fragments=3, data=data[20:40]))
    assert len(assembly.pop_ready()) == 1


def test_reassembler_alines_beyond_window_are_discarded():
    assembly = AlineReassembler(PLAN, 0, window=4, repeat=100)
    for number in range(20):
        assembly.receive(payload(number))
    assert len(assembly.pop_ready()) == 4
    assert assembly.horizon == 4


def test_lines_of_another_plan_are_ignored():
    assembly = AlineReassembler(PLAN, 0, window=4, repeat=100)
    assembly.receive(payload(0, plan=PLAN + 1))
    assert not assembly.pop_ready()


def test_an_impossible_fragment_is_an_error():
    with pytest.raises(FrameError):
        AlineReassembler(PLAN, 0, window=4, repeat=100).receive(payload(0, fragment=2, fragments=2))


def test_samples_that_do_not_match_their_checksum_are_asked_for_again():
    damaged = blob()[:-1] + b"!"
    with pytest.raises(FrameError, match="checksum"):
        parse_record(damaged)
    assembly = AlineReassembler(PLAN, 0, window=4, repeat=100)
    assembly.receive(payload(0, data=damaged))
    assembly.mark_sent(1)
    assert assembly.damaged == 1
    assert assembly.missing(0) == [(0, 0xFF)]


@pytest.mark.parametrize(
    ("data", "encoding"),
    [(b"short", 0), (blob() + b"xx", 0), (blob()[:39], 1), (blob()[:-2], 0), (blob(), 9)],
)
def test_a_blob_of_a_wrong_length_or_an_unknown_encoding_is_refused(data, encoding):
    with pytest.raises(FrameError):
        parse_record(data, encoding)


def several(number: int, values: list[int]) -> bytes:
    """One frame of several A-lines."""
    return pack(ALineHead(PLAN, number, number + 5, 0, 1, 0, len(values) - 1)) + b"".join(map(blob, values))


def test_several_a_lines_of_one_frame_come_out_one_by_one_with_their_own_number_and_point():
    assembly = AlineReassembler(PLAN, 0, window=8, repeat=100)
    assembly.receive(several(0, [3, 4, 5]))
    lines = assembly.pop_ready()
    assert [(line.number, line.point, int(line.samples[0])) for line in lines] == [(0, 5, 3), (1, 6, 4), (2, 7, 5)]


def test_reassembler_multi_aline_frame_keeps_new_intact_alines_in_window():
    assembly = AlineReassembler(PLAN, 0, window=4, repeat=100)
    assembly.receive(payload(1))
    data = bytearray(several(0, [3, 4, 5, 6, 7]))
    data[-1 - 2 * len(blob())] ^= 1  # the samples of number 2
    assembly.receive(bytes(data))
    assert [line.number for line in assembly.pop_ready()] == [0, 1]
    assert (assembly.duplicates, assembly.damaged) == (1, 1)
    assert assembly.missing(0) == [(2, 0xFF)]
    assembly.receive(payload(2))
    assert [line.number for line in assembly.pop_ready()] == [2, 3]


@pytest.mark.parametrize("data", [blob() + b"x", b""])
def test_a_frame_that_does_not_divide_into_its_a_lines_is_an_error(data):
    with pytest.raises(FrameError, match="equal"):
        AlineReassembler(PLAN, 0, window=4, repeat=100).receive(pack(ALineHead(PLAN, 0, 0, 0, 1, 0, 1)) + data)


def test_a_payload_shorter_than_its_head_is_an_error():
    with pytest.raises(FrameError, match="head"):
        AlineReassembler(PLAN, 0, window=4, repeat=100).receive(bytes(15))


def test_reassembler_corrected_fragment_count_restarts_aline():
    assembly, data = AlineReassembler(PLAN, 0, window=4, repeat=100), blob()
    assembly.receive(payload(0, fragment=0, fragments=3, data=data[:20]))
    assembly.receive(payload(0, fragment=0, fragments=2, data=data[:30]))
    assembly.receive(payload(0, fragment=1, fragments=2, data=data[30:]))
    assert len(assembly.pop_ready()) == 1
    assembly.receive(payload(0, fragment=0, fragments=2, data=data[:30]))
    assert assembly.duplicates == 1


def test_a_batch_ends_where_the_length_of_the_a_lines_changes():
    assembly = AlineReassembler(PLAN, 0, window=8, repeat=100)
    short = np.full(4, 1, "<i2").tobytes()
    meta = pack(ALineMeta(0, 0, 1, crc32c(short), 1.0, 8000, 4, 1, 10_000, 0, 0, 0, 0))
    for number, data in enumerate([None, None, meta + short]):
        assembly.receive(payload(number, data=data))
    assert [batch.samples.shape for batch in (assembly.pop_ready(), assembly.pop_ready(), assembly.pop_ready())] == [
        (2, 8),
        (1, 4),
        (0, 0),
    ]


def test_the_columns_of_a_batch_are_the_attributes_of_its_a_lines():
    assembly = AlineReassembler(PLAN, 3, window=8, repeat=100)
    for number in range(3, 6):
        data = np.arange(number, number + 8, dtype="<i2").tobytes()
        values = (70 + number, 1_550_000, number, crc32c(data), 0.25, 8000, 8, 2, 10_012, -1200, -601, 1, -3_000_000)
        assembly.receive(payload(number, data=pack(ALineMeta(*values)) + data))
    batch = assembly.pop_ready()
    assert isinstance(batch, ALineBatch)
    names = [*batch[0].__slots__]
    for name in names:
        assert batch.column(name).tolist() == [
            getattr(line, name).tolist() if name == "samples" else getattr(line, name) for line in batch
        ]
    with pytest.raises(KeyError):
        batch.column("colour")
    assert batch[-1].number == 5
    assert [line.number for line in batch[:2]] == [3, 4]
    assert not batch.samples.flags.writeable
    with pytest.raises(IndexError):
        batch[3]


def test_the_record_has_the_metas_layout():
    assert META.itemsize == LAYOUT[ALineMeta].size
