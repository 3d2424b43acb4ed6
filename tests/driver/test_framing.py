"""Frames survive a bad line: nothing false gets through, and the place is found again."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fabry_perot.errors import FrameError
from fabry_perot.wire.framing import (
    CRC,
    HEADER,
    MAX_PAYLOAD,
    VERSION,
    Deframer,
    Frame,
    crc32c,
    encode_frame,
    encoded_size,
)

frames = st.builds(
    Frame,
    type=st.integers(0, 255),
    flags=st.integers(0, 15),
    boot=st.integers(0, 255),
    session=st.integers(0, 0xFFFF),
    sequence=st.integers(0, 0xFFFF),
    payload=st.binary(max_size=600),
)


@given(st.lists(frames, max_size=5), st.randoms(use_true_random=False))
@settings(deadline=None)
def test_deframer_arbitrary_chunks_restore_all_frames(sent, source):
    data = b"".join(map(encode_frame, sent))
    deframer, received = Deframer(), []
    while data:
        size = source.randint(1, 50)
        received += deframer.feed(data[:size])
        data = data[size:]
    assert received == sent
    assert deframer.counters.bad == 0


@given(frames)
@settings(deadline=None)
def test_a_frame_on_the_line_is_delimited_by_zeros_and_has_none_inside(frame):
    data = encode_frame(frame)
    assert data[0] == data[-1] == 0
    assert 0 not in data[1:-1]
    assert len(data) <= encoded_size(len(frame.payload))


def test_every_corruption_of_a_single_byte_is_rejected_and_the_next_frame_still_arrives():
    frame = Frame(0xA0, 0, 7, 513, 9, bytes(range(20)) + bytes(12))
    following = Frame(0xB0, 0, 7, 513, 10, b"next")
    good = encode_frame(frame)
    for position in range(len(good)):
        for value in range(256):
            if value == good[position]:
                continue
            bad = good[:position] + bytes([value]) + good[position + 1 :]
            received = Deframer().feed(bad + encode_frame(following))
            assert following in received
            if 0 < position < len(good) - 1:
                assert received == [following], (position, value)


@pytest.mark.parametrize("change", ["loss", "insertion", "doubling"])
def test_a_lost_inserted_or_doubled_byte_is_rejected_and_the_next_frame_still_arrives(change):
    good = encode_frame(Frame(0xA0, 0, 7, 513, 9, bytes(range(40))))
    following = Frame(0xB0, 0, 7, 513, 10, b"next")
    for at in range(1, len(good) - 1):
        bad = {
            "loss": good[:at] + good[at + 1 :],
            "insertion": good[:at] + b"\x2a" + good[at:],
            "doubling": good[:at] + good[at : at + 1] + good[at:],
        }[change]
        assert Deframer().feed(bad + encode_frame(following)) == [following]


def test_garbage_before_and_between_frames_is_skipped_and_counted():
    source = random.Random(1)
    frame = Frame(1, 0, 0, 0, 0, b"hello")
    deframer = Deframer()
    received = []
    for _ in range(50):
        received += deframer.feed(source.randbytes(source.randrange(300)) + b"\0" + encode_frame(frame))
    assert received == [frame] * 50
    assert deframer.counters.bad > 50


def test_deframer_noise_without_delimiters_uses_bounded_memory():
    deframer = Deframer()
    for _ in range(100):
        deframer.feed(b"\x55" * 10_000)
        assert len(deframer._pending) <= encoded_size(MAX_PAYLOAD)
    frame = Frame(1, 0, 0, 0, 0, b"after")
    assert deframer.feed(b"\0" + encode_frame(frame)) == [frame]
    assert deframer.counters.oversize == 1


def _raw(body: bytes) -> bytes:
    from cobs import cobs

    return b"\0" + cobs.encode(body + CRC.pack(crc32c(body))) + b"\0"


@pytest.mark.parametrize(
    ("body", "counter"),
    [
        (HEADER.pack(VERSION, 1, 0, 0, 0, 0, 4) + b"abc", "bad_length"),
        (HEADER.pack(VERSION, 1, 0, 0, 0, 0, 2) + b"abc", "bad_length"),
        (HEADER.pack(VERSION, 1, 0, 0, 0, 0, 0)[:9], "bad_length"),
        (b"", "bad_length"),
        (HEADER.pack(VERSION + 1, 1, 0, 0, 0, 0, 0), "bad_version"),
        (HEADER.pack(VERSION, 1, 0x80, 0, 0, 0, 0), "unknown_critical"),
    ],
)
def test_a_valid_checksum_alone_does_not_make_a_frame(body, counter):
    deframer = Deframer()
    assert deframer.feed(_raw(body)) == []
    assert getattr(deframer.counters, counter) == 1 == deframer.counters.bad


def test_a_payload_beyond_the_limit_is_refused_before_it_is_sent():
    with pytest.raises(FrameError, match="32768"):
        encode_frame(Frame(1, 0, 0, 0, 0, bytes(MAX_PAYLOAD + 1)))
