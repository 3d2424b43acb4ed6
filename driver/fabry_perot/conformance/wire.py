"""Conformance tests: frames, sessions and requests."""

from __future__ import annotations

from cobs import cobs

from fabry_perot.conformance.peer import QUIET_PERIOD, ConformanceHost
from fabry_perot.conformance.registry import ConformanceFunction, conformance_test
from fabry_perot.wire.constants import Operation, Result, Type
from fabry_perot.wire.framing import CRC, HEADER, VERSION, crc32c
from fabry_perot.wire.messages import REQUEST_HEAD


@conformance_test("wire")
def hello_nonce(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """HELLO with the same nonce does not change the session; HELLO with another nonce opens a new session."""
    first = peer.connect()
    peer.forget()
    again = peer.open_session(peer.nonce)
    peer.expect(again is not None and again.session == first.session, "the same session for the same nonce")
    second = peer.connect()
    peer.expect(second.session not in (0, first.session), "another session, not 0, for another nonce")
    peer.expect(second.boot == first.boot, "the same boot id")
    peer.expect(64 <= second.max_payload, "a largest payload of at least 64")


@conformance_test("wire")
def version_negotiation(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """A HELLO with unsupported versions is answered by version 0, and the session continues."""
    nonce = peer.nonce
    ack = peer.open_session(nonce ^ 1, 200, 201)
    peer.nonce = nonce
    peer.expect(ack is not None and ack.version == 0, "HELLO_ACK with version 0")
    peer.expect(peer.request(Operation.GET).result == 0, "GET answered in the old session")


@conformance_test("wire")
def checksum(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """A frame with a wrong CRC is dropped and counted."""
    before = peer.request_ok(Operation.GET)["bad_frames"]
    number = peer.next_request_id()
    body = HEADER.pack(VERSION, Type.REQ, 0, *_current_session(peer), 1, 3) + _get(peer, number)
    _ignored(peer, _stuff(body + CRC.pack(crc32c(body) ^ 0x00010000)), number, "a frame with a wrong CRC")
    peer.expect(peer.request_ok(Operation.GET)["bad_frames"] > before, "bad_frames to count it")


@conformance_test("wire")
def length(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """A frame with an inconsistent length is dropped, even with a correct CRC."""
    number = peer.next_request_id()
    for size in (2, 4, 200):
        body = HEADER.pack(VERSION, Type.REQ, 0, *_current_session(peer), 1, size) + _get(peer, number)
        _ignored(peer, _stuff(body + CRC.pack(crc32c(body))), number, f"3 bytes that call themselves {size}")


@conformance_test("wire")
def noise_tolerance(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """Noise, unterminated frames and unknown message types do not affect valid frames."""
    number = peer.next_request_id()
    for data in (bytes(range(1, 255)) * 4, b"\0" * 50, b"\x01" * 40_000, b"\xff\0\xfe\0", peer.frame(0x7F, b"what?")):
        _ignored(peer, data, number, "noise")
    _ignored(peer, peer.frame(Type.REQ, _get(peer, number), flags=0x10), number, "a frame with an unknown flag of 4–7")
    peer.send(Type.LEASE, b"\1\2\3")
    peer.expect(peer.request(Operation.GET).result == 0, "GET answered after a LEASE that is too short")


@conformance_test("wire")
def session(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """A frame of another session is ignored."""
    number, other = peer.next_request_id(), (_current_session(peer)[1] + 1) & 0xFFFF
    _ignored(peer, peer.frame(Type.REQ, _get(peer, number), session=other), number, "a frame of another session")


@conformance_test("wire")
def stale_boot_frames(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """A frame of another boot is ignored."""
    number, other = peer.next_request_id(), _current_session(peer)[0] ^ 1
    _ignored(peer, peer.frame(Type.REQ, _get(peer, number), boot=other), number, "a frame of another boot")


@conformance_test("wire")
def requests(peer: ConformanceHost, ask: ConformanceFunction) -> None:
    """A request is executed once and its reply repeated; old ids are stale, unknown operations rejected."""
    peer.upload(4)
    number = peer.next_request_id()
    first = peer.request(Operation.ARM, number=number)
    peer.expect(first.result == 0, "ARM granted in READY")
    peer.expect(peer.request(Operation.ARM, number=number) == first, "the same reply, token and all, to the same id")
    for _ in range(9):
        peer.request_ok(Operation.GET)
    peer.expect(peer.request(Operation.ARM, number=number).result == Result.STALE_REQUEST, "an old id is stale (6)")
    peer.request_ok(Operation.DISARM)
    number = peer.next_request_id()
    peer.send(Type.REQ, REQUEST_HEAD.pack(number, 250))
    peer.expect(peer.wait(lambda: number in peer.replies, 1.0), "an answer to an unknown operation")
    peer.expect(peer.replies[number].result == Result.UNKNOWN_OPERATION, "result 5 for an unknown operation")
    number = peer.next_request_id()
    peer.send(Type.REQ, REQUEST_HEAD.pack(number, Operation.SET) + b"\xff\xff")
    peer.expect(peer.wait(lambda: number in peer.replies, 1.0), "an answer to parameters that are no CBOR")
    peer.expect(peer.replies[number].result == Result.MALFORMED, "result 7 for parameters that are no CBOR")


def _ignored(peer: ConformanceHost, data: bytes, number: int, what: str) -> None:
    """Send bytes that resemble request ``number``, and check that the device ignores them."""
    peer.raw(data)
    peer.listen(QUIET_PERIOD)
    peer.expect(number not in peer.replies, f"no answer to {what}")
    peer.expect(peer.request(Operation.GET).result == 0, f"GET answered after {what}")


def _get(peer: ConformanceHost, number: int) -> bytes:
    return REQUEST_HEAD.pack(number, Operation.GET)


def _current_session(peer: ConformanceHost) -> tuple[int, int]:
    return (peer.hello.boot & 0xFF, peer.hello.session) if peer.hello else (0, 0)


def _stuff(body: bytes) -> bytes:
    return b"\0" + bytes(cobs.encode(body)) + b"\0"
