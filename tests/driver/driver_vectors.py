"""Makes driver/vectors/*.json: single frames, right and wrong ones, and whole conversations on the bench.

``python tests/driver/driver_vectors.py`` writes them anew after a change of the protocol.
"""

from __future__ import annotations

import json
from pathlib import Path

import cobs.cobs
from driver_bench import DEVICE_EPOCH, Bench, truth
from driver_faults import FramesOfType

from fabry_perot.wire.constants import AbortLevel, Operation, Result, Type
from fabry_perot.wire.framing import CRC, HEADER, VERSION, Frame, crc32c, encode_frame
from fabry_perot.wire.messages import (
    CAPS_HEAD,
    CAPS_REQUEST,
    REPLY_HEAD,
    REQUEST_HEAD,
    Abort,
    AbortAck,
    ALineHead,
    ALineMeta,
    Fault,
    Hello,
    HelloAck,
    Lease,
    pack,
    pack_body,
)

FOLDER = Path(__file__).parents[2] / "driver" / "vectors"
SESSION, TAG, PLAN = 0x0102, 7, 0xCAFEF00D
BEAMS = {"plan": PLAN, "length": 1616, "samples": 1024, "interval_ps": 8000, "pulse_rate_mhz": 50_000, "beams": 16}
THREE = {"beams": 3, "beam_offsets_nm": [[0, 0], [800_000, 0], [0, 800_000]]}


def _aline() -> list[tuple[str, Type, int, bytes]]:
    samples = truth(3, 60)
    meta = ALineMeta(9_000_000, 1_550_000, 4, crc32c(samples.tobytes()), 0.25, 8000, 60, 1, 10_000, 1200, 0, 0, 0)
    blob, room = pack(meta) + samples.tobytes(), 64 - 16
    pieces = [blob[at : at + room] for at in range(0, len(blob), room)]
    return [
        (
            f"ALINE piece {i + 1} of {len(pieces)}",
            Type.ALINE,
            0,
            pack(ALineHead(PLAN, 3, 3, i, len(pieces), 0, 0)) + piece,
        )
        for i, piece in enumerate(pieces)
    ]


def right_frames() -> list[dict]:
    start = {"token": 99, "echo": 7_000_000, "ttl": 500_000}
    other = HelloAck(0x12345678, 0xB007, SESSION, 0, 1, 5, 1, 8192, 512, 300, 0xDEADBEEF, 0, 0, 0, 0, 0, 7_000_000)
    listed = [
        ("CAPS", Type.CAPS, 0, CAPS_REQUEST.pack(50)),
        ("CAPS piece", Type.CAPS_PIECE, 0, CAPS_HEAD.pack(0, 15) + pack_body({"clock_rate": 1.0})),
        ("REQ START", Type.REQ, 0, REQUEST_HEAD.pack(6, Operation.START) + pack_body(start)),
        ("RSP START", Type.RSP, 0, REPLY_HEAD.pack(6, Operation.START, 0, 5) + pack_body({"laser_shots": 12})),
        ("RSP START, no lease", Type.RSP, 0, REPLY_HEAD.pack(6, Operation.START, Result.NO_LEASE, 4) + pack_body({})),
        ("RSP PLAN_NEW, start out of range", Type.RSP, 0, REPLY_HEAD.pack(4, 3, 2, 2) + pack_body({"field": "start"})),
        ("REQ PLAN_NEW, 16 beams", Type.REQ, 0, REQUEST_HEAD.pack(4, Operation.PLAN_NEW) + pack_body(BEAMS)),
        ("RSP PLAN_NEW, too many beams", Type.RSP, 0, REPLY_HEAD.pack(4, 3, 2, 2) + pack_body({"field": "beams"})),
        ("ABORT_ACK", Type.ABORT_ACK, 2, pack(AbortAck(2, 0x12345679, 11))),
        ("FAULT_ACK", Type.FAULT_ACK, 0, pack(Fault(1, 1))),
        ("BUSY", Type.BUSY, 2, b"192.0.2.7:50000"),
        ("HELLO_ACK, no version in common", Type.HELLO_ACK, 0, pack(other)),
        *_aline(),
    ]
    found = []
    for number, (name, kind, flags, payload) in enumerate(listed, start=1):
        tag, session = (0, 0) if kind is Type.BUSY else (TAG, SESSION)
        frame = Frame(kind, flags, tag, session, number, payload)
        fields = {"type": int(kind), "flags": flags, "boot": tag, "session": session, "sequence": number}
        found.append({"name": name, **fields, "payload": payload.hex(), "bytes": encode_frame(frame).hex()})
    return found


def _raw(payload: bytes, *, version: int = VERSION, flags: int = 0, size: int | None = None, spoil: int = 0) -> str:
    head = HEADER.pack(version, Type.LEASE, flags, TAG, SESSION, 1, len(payload) if size is None else size)
    body = head + payload
    return (b"\0" + cobs.cobs.encode(body + CRC.pack(crc32c(body) ^ spoil)) + b"\0").hex()


def wrong_frames() -> list[dict]:
    lease = pack(Lease(0xB007, 7_000_000, 500_000))
    named = {
        "the checksum is wrong": _raw(lease, spoil=1),
        "the length is one too many, the checksum right": _raw(lease, size=len(lease) + 1),
        "another version of the frame": _raw(lease, version=0xF2),
        "an unknown flag of bits 4 to 7": _raw(lease, flags=0x10),
        "shorter than a header and a checksum": (b"\0" + cobs.cobs.encode(bytes(13)) + b"\0").hex(),
        "stuffing that points past its end": "00ff0102030400",
    }
    return [{"name": name, "bytes": data} for name, data in named.items()]


def _record(name: str, what: str, scene, **limits: object) -> dict:
    bench = Bench(max_payload=200, **limits)
    steps: list[dict] = []

    def note(who: str, epoch: int):
        def see(data: bytes, now: int) -> bytes:
            if data:
                steps.append({"at": now + epoch, "from": who, "bytes": data.hex()})
            return data

        return see

    bench.up.filters.append(note("host", 0))
    bench.down.filters.append(note("device", 0))
    scene(bench)
    return {"name": name, "what": what, "device_epoch": DEVICE_EPOCH, "steps": steps}


def _scan(bench: Bench) -> None:
    bench.scan(5, samples=200)
    bench.finish()


def _repaired(bench: Bench) -> None:
    bench.down.filters.insert(0, FramesOfType(Type.ALINE, lambda count: count == 4))
    _scan(bench)
    bench.run(300)


def _together(bench: Bench) -> None:
    bench.scan(2, samples=200, beams=3)
    bench.finish()


def _refused(bench: Bench) -> None:
    bench.connect()
    bench.upload(5, samples=200)
    now, session = bench.device_now, bench.host.session
    stale = REQUEST_HEAD.pack(900, Operation.ARM)
    for frame in (
        Frame(Type.HELLO, 0, 0, 0, 1, pack(Hello(7, 9, 200, 77))),
        Frame(Type.REQ, 0, TAG, session ^ 1, 2, stale),
        Frame(Type.REQ, 0, TAG, session, 3, REQUEST_HEAD.pack(901, Operation.START) + pack_body({"token": 1})),
        Frame(Type.LEASE, 0, TAG, session, 4, pack(Lease(0xB007, now + 100_000_000, 500_000))),
        Frame(Type.ABORT, 2, 0, 0, 5, pack(Abort(AbortLevel.EMERGENCY_STOP, 0x5EED))),
        Frame(Type.REQ, 0, TAG, session, 6, REQUEST_HEAD.pack(902, Operation.ARM)),
    ):
        bench.up.put(encode_frame(frame), bench.clock.now())
        bench.run(5)
    bench.run(50)


def transcripts() -> list[dict]:
    return [
        _record("scan", "HELLO to DONE: five A-lines, each in several frames, stored one by one", _scan),
        _record("repair", "the same, but the fifth ALINE frame is lost and asked for again", _repaired),
        _record("beams", "two places of a device with three beams: six A-lines of two shots", _together, **THREE),
        _record(
            "refusals",
            "versions 7 to 9; ARM of another session; START without echo; an echo of the future; an emergency stop"
            " without a session; ARM while it is latched",
            _refused,
        ),
    ]


def write() -> None:
    FOLDER.mkdir(exist_ok=True)
    for name, content in (
        ("frames", {"right": right_frames(), "wrong": wrong_frames()}),
        ("transcripts", transcripts()),
    ):
        (FOLDER / f"{name}.json").write_text(json.dumps(content, indent=1) + "\n")


if __name__ == "__main__":
    write()
