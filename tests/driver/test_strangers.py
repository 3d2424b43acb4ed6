"""What a host or device written from PROTOCOL.md alone runs into: no session yet, other versions, refusals by name."""

from __future__ import annotations

import re
from pathlib import Path

import cbor2
import pytest
from driver_bench import Bench

from fabry_perot.device.request_handlers import execute
from fabry_perot.host import Host
from fabry_perot.wire.constants import AbortLevel, Operation, Type
from fabry_perot.wire.framing import Deframer, Frame, encode_frame
from fabry_perot.wire.messages import AbortAck, Hello, HelloAck, pack, unpack
from fabry_perot.wire.states import DeviceState

DOCUMENT = (Path(__file__).parents[2] / "driver" / "PROTOCOL.md").read_text()


def test_an_abort_before_a_session_is_acknowledged_to_the_host():
    bench = Bench()
    bench.host.phase = bench.host.phase.HELLO
    bench.up.filters.append(
        lambda data, now: b"".join(encode_frame(f) for f in Deframer().feed(data) if f.type == 0x31)
    )
    bench.host.abort(AbortLevel.LASER_OFF, bench.clock.now())
    bench.run(200)
    assert bench.host.session == 0
    assert not bench.host.aborting


def test_an_acknowledgement_of_an_earlier_abort_confirms_no_later_one():
    bench = Bench()
    bench.scan(500)
    bench.host.abort(AbortLevel.LASER_OFF, bench.clock.now())
    bench.run(50)
    old = encode_frame(Frame(Type.ABORT_ACK, 2, 7, bench.host.session, 0, pack(AbortAck(2, 1, DeviceState.SAFE_HOLD))))
    bench.host.abort(AbortLevel.LASER_OFF, bench.clock.now())
    bench.host.receive(old, bench.clock.now())
    other = Host(nonce=99)
    other.open(0)
    other.abort(AbortLevel.LASER_OFF, 0)
    other.receive(old, 0)
    assert bench.host.aborting
    assert other.aborting


@pytest.mark.parametrize("versions", [(0, 0), (3, 9)])
def test_hello_with_unsupported_version_is_rejected_and_scan_continues(versions):
    bench = Bench()
    bench.scan(500)
    bench.run(60)
    session, shots = bench.host.session, len(bench.instrument.log)
    stranger = Frame(Type.HELLO, 0, 0, 0, 1, pack(Hello(*versions, 8192, 77)))
    bench.device.receive(encode_frame(stranger), bench.device_now)
    answers = [
        unpack(HelloAck, frame.payload)
        for frame in Deframer().feed(bench.device.next_frames(9999))
        if frame.type == 0x81
    ]
    assert [(answer.nonce, answer.version) for answer in answers] == [(77, 0)]
    bench.run(200)
    assert bench.device.state is DeviceState.SCANNING
    assert bench.device.outbox.session == session
    assert len(bench.instrument.log) > shots


PLAN = {"plan": 1, "length": 4, "samples": 64, "interval_ps": 8000, "pulse_rate_mhz": 50_000, "purge": True}
SWEEP = {"x": 0, "y": 0, "from_pm": 1_500_000, "to_pm": 1_600_000, "steps": 11}


@pytest.mark.parametrize(
    ("operation", "body", "field"),
    [
        (Operation.PLAN_NEW, {**PLAN, "plan": 0}, "plan"),
        (Operation.PLAN_NEW, {**PLAN, "length": 0}, "length"),
        (Operation.PLAN_NEW, {**PLAN, "start": 4}, "start"),
        (Operation.TUNE_SCAN, {**SWEEP, "steps": 1}, "steps"),
        (Operation.TUNE_SCAN, {**SWEEP, "steps": 257}, "steps"),
        (Operation.TUNE_SCAN, {**SWEEP, "to_pm": 1_700_000}, "to_pm"),
        (Operation.TUNE_SCAN, {**SWEEP, "from_pm": 1_400_000}, "from_pm"),
        (Operation.TUNE_SCAN, {**SWEEP, "x": 1 << 30}, "x"),
    ],
)
def test_a_refusal_names_the_parameter_as_it_was_given(operation, body, field):
    bench = Bench()
    bench.connect()
    _, answer = execute(bench.device, operation, body)
    assert answer == {"field": field}


def test_every_name_that_get_answers_is_in_the_document():
    bench = Bench()
    bench.connect()
    answer = bench.call(Operation.GET)
    section = DOCUMENT.split("**GET** answers")[1].split("\n\n")[0]
    assert set(answer) - set(bench.instrument.values) == set(re.findall(r"`(\w+)`", section))


def test_cbor_encoding_matches_protocol_document():
    assert cbor2.dumps({"clock_rate": 1.0}, canonical=True).hex() in DOCUMENT.replace(" ", "")
    for width in ("fb3ff0000000000000", "fa3f800000", "f93c00"):
        assert cbor2.loads(bytes.fromhex(width)) == 1.0
