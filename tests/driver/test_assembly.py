"""The host's A-line assembly alone."""

from __future__ import annotations

import numpy as np
import pytest

from fabry_perot.aline import ALine
from fabry_perot.errors import FrameError
from fabry_perot.framing import crc32c
from fabry_perot.host.assembly import Assembly
from fabry_perot.messages import ALineHead, ALineMeta, pack

PLAN = 9


def blob(value: int = 7) -> bytes:
    data = np.full(8, value, "<i2").tobytes()
    return pack(ALineMeta(0, 0, 1, crc32c(data), 1.0, 8000, 8, 1, 10_000, 0, 0, 0, 0)) + data


def payload(number: int, *, plan: int = PLAN, fragment: int = 0, fragments: int = 1, data: bytes | None = None):
    return pack(ALineHead(plan, number, number, fragment, fragments, 0, 0)) + (blob() if data is None else data)


def test_lines_out_of_order_are_delivered_in_order_and_the_gap_is_asked_for_once_per_repeat_time():
    assembly = Assembly(PLAN, 0, window=8, repeat=100)
    assembly.receive(payload(1))
    assert assembly.take() == []
    assert assembly.missing(0) == [(0, 0xFF)]
    assert assembly.missing(50) == []
    assert assembly.missing(100) == [(0, 0xFF)]
    assembly.receive(payload(0))
    assert [line.number for line in assembly.take()] == [0, 1]
    assert not assembly.gaps


def test_only_the_missing_fragment_is_asked_for():
    assembly = Assembly(PLAN, 0, window=8, repeat=100)
    data = blob()
    assembly.receive(payload(0, fragment=0, fragments=3, data=data[:20]))
    assembly.receive(payload(0, fragment=2, fragments=3, data=data[40:]))
    assembly.sent(1)
    assert assembly.missing(0) == [(0, 1)]
    assembly.receive(payload(0, fragment=1, fragments=3, data=data[20:40]))
    assert len(assembly.take()) == 1


def test_nothing_beyond_the_window_is_kept_so_memory_is_bounded():
    assembly = Assembly(PLAN, 0, window=4, repeat=100)
    for number in range(20):
        assembly.receive(payload(number))
    assert len(assembly.take()) == 4
    assert assembly.horizon == 4


def test_lines_of_another_plan_are_ignored():
    assembly = Assembly(PLAN, 0, window=4, repeat=100)
    assembly.receive(payload(0, plan=PLAN + 1))
    assert assembly.take() == []


def test_an_impossible_fragment_is_an_error():
    with pytest.raises(FrameError):
        Assembly(PLAN, 0, window=4, repeat=100).receive(payload(0, fragment=2, fragments=2))


def test_samples_that_do_not_match_their_checksum_are_asked_for_again():
    damaged = blob()[:-1] + b"!"
    with pytest.raises(FrameError, match="checksum"):
        ALine.from_blob(0, 0, damaged)
    assembly = Assembly(PLAN, 0, window=4, repeat=100)
    assembly.receive(payload(0, data=damaged))
    assembly.sent(1)
    assert assembly.damaged == 1
    assert assembly.missing(0) == [(0, 0xFF)]
