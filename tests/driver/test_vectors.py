"""driver/vectors/*.json: frames and conversations that any implementation can be held against, ours first."""

from __future__ import annotations

import json

import driver_vectors
import pytest
from driver_bench import truth
from driver_reference import ALines, frames

from fabry_perot.host import Host
from fabry_perot.wire.constants import Operation, Result, Type
from fabry_perot.wire.framing import Deframer, Frame, encode_frame
from fabry_perot.wire.messages import REPLY_HEAD, unpack_exact
from fabry_perot.wire.states import DeviceState

FRAMES = json.loads((driver_vectors.FOLDER / "frames.json").read_text())
TALKS = {talk["name"]: talk for talk in json.loads((driver_vectors.FOLDER / "transcripts.json").read_text())}


@pytest.mark.parametrize("vector", FRAMES["right"], ids=lambda vector: vector["name"])
def test_vector_valid_frame_encodes_and_decodes_identically(vector):
    fields = [vector[name] for name in ("type", "flags", "boot", "session", "sequence")]
    frame, data = Frame(*fields, bytes.fromhex(vector["payload"])), bytes.fromhex(vector["bytes"])
    assert encode_frame(frame) == data
    assert Deframer().feed(data) == [frame]
    (other,) = frames(data)
    assert other["payload"] == frame.payload


@pytest.mark.parametrize("vector", FRAMES["wrong"], ids=lambda vector: vector["name"])
def test_a_wrong_frame_is_dropped_by_both_readers_and_the_next_one_understood(vector):
    right = bytes.fromhex(FRAMES["right"][0]["bytes"])
    data = bytes.fromhex(vector["bytes"]) + right
    assert len(Deframer().feed(data)) == len(frames(data)) == 1


def test_the_a_line_in_pieces_has_the_samples_of_its_point():
    reader = ALines()
    for vector in FRAMES["right"]:
        for frame in frames(bytes.fromhex(vector["bytes"])):
            reader.take(frame)
    ((_, line),) = reader.lines.items()
    assert line["values"] == truth(3, 60).tolist()


def test_vector_files_equal_generated_vectors():
    assert FRAMES == {"right": driver_vectors.right_frames(), "wrong": driver_vectors.wrong_frames()}
    assert list(TALKS.values()) == driver_vectors.transcripts()


@pytest.mark.parametrize(("name", "count"), [("scan", 5), ("repair", 5), ("beams", 6)])
def test_a_host_that_hears_the_device_of_a_transcript_ends_up_with_its_a_lines(name, count):
    host, lines = Host(nonce=1), []
    host.open(0)
    for step in TALKS[name]["steps"]:
        if step["from"] == "device":
            host.receive(bytes.fromhex(step["bytes"]), step["at"])
        for payload in (f.payload for f in Deframer().feed(bytes.fromhex(step["bytes"])) if f.type == Type.PLAN_STATUS):
            if host.assembly is None and payload[:4] != bytes(4):
                host.receive_from(int.from_bytes(payload[:4], "little"), 0)
        lines += host.take()
    assert host.device_state is DeviceState.DONE
    assert [line.number for line in lines] == list(range(count))
    assert all((line.samples == truth(line.point, 200)).all() for line in lines)


def test_vector_refusals_match_protocol_document():
    sent = [
        frame
        for step in TALKS["refusals"]["steps"]
        if step["from"] == "device"
        for frame in Deframer().feed(bytes.fromhex(step["bytes"]))
    ]
    replies = [unpack_exact(REPLY_HEAD, frame.payload, tail=True) for frame in sent if frame.type == Type.RSP]
    answers = {number: (operation, result, state) for number, operation, result, state in replies}
    assert 900 not in answers, "of another session"
    assert answers[901] == (Operation.START, Result.MALFORMED, DeviceState.READY)
    assert answers[902] == (Operation.ARM, Result.WRONG_STATE, DeviceState.ESTOP)
    acks = [frame.payload for frame in sent if frame.type == Type.ABORT_ACK]
    assert acks[0] == bytes([3]) + (0x5EED).to_bytes(4, "little") + bytes([DeviceState.ESTOP])
    versions = [frame.payload[10] for frame in sent if frame.type == Type.HELLO_ACK and frame.payload[:4] == b"M\0\0\0"]
    assert versions == [0]
