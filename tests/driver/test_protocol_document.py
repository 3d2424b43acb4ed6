"""driver/PROTOCOL.md and the code say the same."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from driver_reference import rice

from fabry_perot.device import DeviceTiming
from fabry_perot.device.message_handlers import MIN_PAYLOAD
from fabry_perot.device.request_handlers import MAX_STEPS
from fabry_perot.errors import FrameError
from fabry_perot.host import HostTiming, RecoveryPolicy
from fabry_perot.wire.constants import MAX_GROUP, MAX_MISSING, Operation, Result, Type
from fabry_perot.wire.encoding import Encoding, encode
from fabry_perot.wire.framing import MAX_PAYLOAD, UART_PAYLOAD, USB_PAYLOAD, Deframer, Frame, crc32c, encode_frame
from fabry_perot.wire.messages import (
    LAYOUT,
    MISSING,
    PLAN_HEAD,
    POINT,
    REPLY_HEAD,
    REQUEST_HEAD,
    Abort,
    ALineAck,
    ALineGone,
    ALineHead,
    ALineMeta,
    Fault,
    Hello,
    HelloAck,
    Lease,
    PlanStatus,
    Status,
    pack,
    pack_body,
    unpack,
    unpack_body,
)
from fabry_perot.wire.states import TRANSITIONS, DeviceState, Event

DOCUMENT = (Path(__file__).parents[2] / "driver" / "PROTOCOL.md").read_text()
VECTORS = dict(re.findall(r"^([A-Z_ ]+) \(.*\):\n\n    ([0-9a-f ]+)$", DOCUMENT, re.MULTILINE))
PLAN = 0xCAFEF00D
SAMPLES = np.array([1, -2, 300], "<i2").tobytes()


def point() -> bytes:
    record = np.zeros(1, POINT)
    record["x"], record["y"], record["averages"] = -1_500_000, 250_000, 1
    return record.tobytes()


META = ALineMeta(7_020_000, 1_550_000, 12, crc32c(SAMPLES), 0.25, 8000, 3, 1, 10_012, 1200, -600, 0, 123_456)
STATUS = Status(
    7_020_000, 0xB007, 5, 31, 0, 0, 400, PLAN, 12, 12, 11, 10, 12, 0, 7_020_000, 7_420_000, -1_500_000, 250_000, 0
)
PLAN_NEW = {
    "plan": PLAN,
    "length": 20,
    "samples": 1024,
    "interval_ps": 8000,
    "pulse_rate_mhz": 50_000,
    "purge": True,
    "start": 5,
    "encoding": 1,
    "group": 255,
}
FRAMES = {
    "HELLO": Frame(Type.HELLO, 0, 0, 0, 1, pack(Hello(2, 2, 8192, 0x12345678))),
    "LEASE": Frame(Type.LEASE, 0, 7, 0x0102, 2, pack(Lease(0xB007, 7_000_000, 500_000))),
    "ABORT": Frame(Type.ABORT, 2, 7, 0x0102, 3, pack(Abort(2, 1))),
    "REQ ARM": Frame(Type.REQ, 0, 7, 0x0102, 4, REQUEST_HEAD.pack(5, Operation.ARM)),
    "PLAN_DATA": Frame(Type.PLAN_DATA, 0, 7, 0x0102, 5, PLAN_HEAD.pack(PLAN, 0, 1) + point()),
    "ALINE_ACK": Frame(Type.ALINE_ACK, 0, 7, 0x0102, 6, pack(ALineAck(PLAN, 10, 522)) + MISSING.pack(11, 0xFF)),
    "ALINE": Frame(Type.ALINE, 0, 7, 0x0102, 7, pack(ALineHead(PLAN, 11, 11, 0, 1, 0, 0)) + pack(META) + SAMPLES),
    "ALINE OF TWO": Frame(
        Type.ALINE, 0, 7, 0x0102, 15, pack(ALineHead(PLAN, 11, 11, 0, 1, 0, 1)) + 2 * (pack(META) + SAMPLES)
    ),
    "HELLO_ACK": Frame(
        Type.HELLO_ACK,
        0,
        7,
        0x0102,
        9,
        pack(HelloAck(0x12345678, 0xB007, 0x0102, 2, 1, 1, 1, 8192, 512, 300, 0xDEADBEEF, 0, 0, 0, 0, 0, 7_000_000)),
    ),
    "STATUS": Frame(Type.STATUS, 0, 7, 0x0102, 10, pack(STATUS)),
    "REQ PLAN_NEW": Frame(Type.REQ, 0, 7, 0x0102, 11, REQUEST_HEAD.pack(4, Operation.PLAN_NEW) + pack_body(PLAN_NEW)),
    "RSP ARM": Frame(Type.RSP, 0, 7, 0x0102, 12, REPLY_HEAD.pack(5, Operation.ARM, 0, 4) + pack_body({"token": 99})),
    "ALINE_GONE": Frame(Type.ALINE_GONE, 0, 7, 0x0102, 13, pack(ALineGone(PLAN, 10, 2, 1))),
    "FAULT": Frame(Type.FAULT, 2, 7, 0x0102, 14, pack(Fault(1, 1))),
    "PLAN_STATUS": Frame(Type.PLAN_STATUS, 0, 7, 0x0102, 8, pack(PlanStatus(PLAN, 1, 1, 0))),
}


def test_the_document_has_a_vector_for_each_frame_checked_here():
    assert set(VECTORS) == set(FRAMES)


@pytest.mark.parametrize("name", FRAMES)
def test_protocol_golden_frame_encodes_and_decodes_identically(name):
    data = bytes.fromhex(VECTORS[name])
    assert encode_frame(FRAMES[name]) == data
    assert Deframer().feed(data) == [FRAMES[name]]


def test_protocol_golden_packed_samples_encode_and_decode_identically():
    words = re.search(r"^SAMPLES as delta-rice .*:\n\n    ([0-9a-f ]+)$", DOCUMENT, re.MULTILINE).group(1)
    samples = np.array([0, 1, 3, 2, -5, -5, 40, 39] * 5, np.int16)[:36]
    assert encode(samples, Encoding.DELTA_RICE) == (Encoding.DELTA_RICE, bytes.fromhex(words))
    assert rice(bytes.fromhex(words), 36) == samples.tolist()


def test_the_table_of_transitions_is_the_codes():
    rows = re.findall(r"^\| ([A-Z_]+) \| ([A-Z_, ]+) \| ([A-Z_]+) \|$", DOCUMENT, re.MULTILINE)
    table = {
        (DeviceState[state], Event[event]): DeviceState[after]
        for event, states, after in rows
        for state in states.split(", ")
    }
    assert table == TRANSITIONS


def test_every_capability_in_the_table_is_one_the_simulator_sends():
    from fabry_perot.simulator.instrument import SimulatedInstrument
    from fabry_perot.simulator.phantoms import yarn

    section = DOCUMENT.split("**Capabilities**")[1].split("## Device states")[0]
    keys = {key for cell in re.findall(r"^\| ([a-z_, ]+) \|", section, re.MULTILINE) for key in cell.split(", ")}
    assert keys - {"key"} == {*SimulatedInstrument(yarn(0)).capabilities(), "lease_cap_us"}


def test_the_time_limits_are_the_codes():
    host, device = HostTiming(), DeviceTiming()
    assert f"| STATUS | {device.status_period // 1000} ms and" in DOCUMENT
    assert f"TTL {host.ttl // 1000} ms, cap {device.lease_cap // 1_000_000} s" in DOCUMENT
    assert f"| HELLO | every {host.hello_period // 1000} ms, {host.hello_tries} times |" in DOCUMENT
    assert f"| REQ | every {host.request_period // 1000} ms, {host.request_tries} times" in DOCUMENT
    assert f"| ABORT | every {host.abort_period // 1000} ms" in DOCUMENT
    assert f"| LEASE | at most every {host.lease_period // 1000} ms" in DOCUMENT
    assert f"and every {host.ack_period // 1000} ms while" in DOCUMENT
    assert f"asked for at most every {2 * host.ack_period // 1000} ms" in DOCUMENT
    assert f"index after {host.upload_period // 1000} ms" in DOCUMENT
    assert f"| FAULT | every {device.fault_period // 1000} ms" in DOCUMENT
    assert f"{device.shutter // 1000} ms after the close command" in DOCUMENT
    silence = f"silence | without STATUS for {host.silence // 1000} ms the host repeats HELLO"
    assert f"{silence}, after {host.patience // 10**6} s" in DOCUMENT
    assert f"at most {MAX_PAYLOAD} bytes; {UART_PAYLOAD} on a UART, {USB_PAYLOAD} on USB" in DOCUMENT
    assert f"lesser of both sides', at least {MIN_PAYLOAD}" in DOCUMENT
    assert f"steps (2 … {MAX_STEPS})" in DOCUMENT
    assert f"× 0 … {MAX_MISSING}" in DOCUMENT
    assert f"group (1 … {MAX_GROUP}; 1)" in DOCUMENT
    assert f"No more than {RecoveryPolicy().within:g} s have passed" in DOCUMENT
    assert f"one START within {device.arm_timeout // 1_000_000} s" in DOCUMENT


def test_the_checksum_is_castagnolis():
    assert crc32c(b"123456789") == 0xE3069283


SIZES = {"u8": 1, "i8": 1, "u16": 2, "i16": 2, "u32": 4, "i32": 4, "f32": 4, "u64": 8}


@pytest.mark.parametrize(
    ("name", "kind"),
    [("HELLO", Hello), ("HELLO_ACK", HelloAck), ("STATUS", Status), ("PLAN_STATUS", PlanStatus), ("LEASE", Lease)],
)
def test_the_fields_in_the_table_add_up_to_the_messages_size(name, kind):
    row = re.search(rf"^\| [0-9A-F]+ \| {name} \| (.*) \|$", DOCUMENT, re.MULTILINE)
    text = row.group(1).replace("u8, newest u8 (protocol", "u8, newest u8 (")
    fields = re.findall(r"\b([iuf]\d+)\b", text)
    assert sum(SIZES[field] for field in fields) == LAYOUT[kind].size
    assert len(fields) == len(kind._fields)


def test_the_meta_and_the_point_have_the_sizes_the_document_gives():
    assert LAYOUT[ALineMeta].size == 44
    assert POINT.itemsize == 16
    assert LAYOUT[ALineHead].size == 16


def test_the_document_numbers_types_operations_results_and_states_as_the_code_does():
    for kind in Type:
        name = kind.name.replace("CAPS_PIECE", "CAPS piece")
        assert re.search(rf"\b{kind:02X}\b[^\n]*{name}|B2 / 32 \| FAULT / FAULT_ACK", DOCUMENT), kind
    for operation in Operation:
        assert f"{operation.value} {operation.name}" in DOCUMENT
    for result in Result:
        assert f"{result.value} {result.name.lower().replace('_', ' ')}" in DOCUMENT.replace("\n", " ")
    for state in DeviceState:
        assert f"{state.name} {state.value}" in DOCUMENT.replace("\n", " ")


@pytest.mark.parametrize("kind", list(LAYOUT))
def test_a_payload_one_byte_short_or_long_is_refused(kind):
    size = LAYOUT[kind].size
    for wrong in (0, size - 1, size + 1):
        with pytest.raises(FrameError):
            unpack(kind, bytes(wrong))
    assert pack(unpack(kind, bytes(size))) == bytes(size)


@pytest.mark.parametrize("data", [b"\xff", b"\x01", b"\x80", b"\xa1\x01\x02", b"\xa1", b"\x9f" * 3000])
def test_parameters_that_are_no_map_with_text_keys_are_refused(data):
    with pytest.raises(FrameError):
        unpack_body(data)
