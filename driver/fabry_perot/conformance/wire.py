"""Frames, sessions and requests."""

from __future__ import annotations

from cobs import cobs

from fabry_perot.conformance.peer import QUIET, Peer
from fabry_perot.conformance.scenarios import Asking, scenario
from fabry_perot.wire.codes import Operation, Result, Type
from fabry_perot.wire.framing import CRC, HEADER, VERSION, crc32c
from fabry_perot.wire.messages import REQUEST_HEAD


@scenario("wire")
def hello(peer: Peer, ask: Asking) -> None:
    """HELLO with the same nonce changes nothing; with another nonce it begins another session."""
    first = peer.connect()
    peer.forget()
    again = peer.say_hello(peer.nonce)
    peer.need(again is not None and again.session == first.session, "the same session for the same nonce")
    second = peer.connect()
    peer.need(second.session not in (0, first.session), "another session, not 0, for another nonce")
    peer.need(second.boot == first.boot, "the same boot id")
    peer.need(64 <= second.max_payload, "a largest payload of at least 64")


@scenario("wire")
def versions(peer: Peer, ask: Asking) -> None:
    """A HELLO with unsupported versions is answered by version 0, and the session continues."""
    nonce = peer.nonce
    ack = peer.say_hello(nonce ^ 1, 200, 201)
    peer.nonce = nonce
    peer.need(ack is not None and ack.version == 0, "HELLO_ACK with version 0")
    peer.need(peer.request(Operation.GET).result == 0, "GET answered in the old session")


@scenario("wire")
def checksum(peer: Peer, ask: Asking) -> None:
    """A frame with a wrong CRC is dropped and counted."""
    before = peer.succeed(Operation.GET)["bad_frames"]
    number = peer.number()
    body = HEADER.pack(VERSION, Type.REQ, 0, *_mine(peer), 1, 3) + _get(peer, number)
    _ignored(peer, _stuff(body + CRC.pack(crc32c(body) ^ 0x00010000)), number, "a frame with a wrong CRC")
    peer.need(peer.succeed(Operation.GET)["bad_frames"] > before, "bad_frames to count it")


@scenario("wire")
def length(peer: Peer, ask: Asking) -> None:
    """A frame whose length does not hold is dropped, though its CRC is right."""
    number = peer.number()
    for size in (2, 4, 200):
        body = HEADER.pack(VERSION, Type.REQ, 0, *_mine(peer), 1, size) + _get(peer, number)
        _ignored(peer, _stuff(body + CRC.pack(crc32c(body))), number, f"3 bytes that call themselves {size}")


@scenario("wire")
def noise(peer: Peer, ask: Asking) -> None:
    """Noise, frames without end and unknown types cost nothing but themselves."""
    number = peer.number()
    for data in (bytes(range(1, 255)) * 4, b"\0" * 50, b"\x01" * 40_000, b"\xff\0\xfe\0", peer.frame(0x7F, b"what?")):
        _ignored(peer, data, number, "noise")
    _ignored(peer, peer.frame(Type.REQ, _get(peer, number), flags=0x10), number, "a frame with an unknown flag of 4–7")
    peer.send(Type.LEASE, b"\1\2\3")
    peer.need(peer.request(Operation.GET).result == 0, "GET answered after a LEASE that is too short")


@scenario("wire")
def session(peer: Peer, ask: Asking) -> None:
    """A frame of another session is ignored."""
    number, other = peer.number(), (_mine(peer)[1] + 1) & 0xFFFF
    _ignored(peer, peer.frame(Type.REQ, _get(peer, number), session=other), number, "a frame of another session")


@scenario("wire")
def boot(peer: Peer, ask: Asking) -> None:
    """A frame of another boot is ignored."""
    number, other = peer.number(), _mine(peer)[0] ^ 1
    _ignored(peer, peer.frame(Type.REQ, _get(peer, number), boot=other), number, "a frame of another boot")


@scenario("wire")
def requests(peer: Peer, ask: Asking) -> None:
    """A request is carried out once, its reply repeated; old ids are stale, unknown operations refused."""
    peer.upload(4)
    number = peer.number()
    first = peer.request(Operation.ARM, number=number)
    peer.need(first.result == 0, "ARM granted in READY")
    peer.need(peer.request(Operation.ARM, number=number) == first, "the same reply, token and all, to the same id")
    for _ in range(9):
        peer.succeed(Operation.GET)
    peer.need(peer.request(Operation.ARM, number=number).result == Result.STALE_REQUEST, "an old id is stale (6)")
    peer.succeed(Operation.DISARM)
    number = peer.number()
    peer.send(Type.REQ, REQUEST_HEAD.pack(number, 250))
    peer.need(peer.wait(lambda: number in peer.replies, 1.0), "an answer to an unknown operation")
    peer.need(peer.replies[number].result == Result.UNKNOWN_OPERATION, "result 5 for an unknown operation")
    number = peer.number()
    peer.send(Type.REQ, REQUEST_HEAD.pack(number, Operation.SET) + b"\xff\xff")
    peer.need(peer.wait(lambda: number in peer.replies, 1.0), "an answer to parameters that are no CBOR")
    peer.need(peer.replies[number].result == Result.MALFORMED, "result 7 for parameters that are no CBOR")


def _ignored(peer: Peer, data: bytes, number: int, what: str) -> None:
    """Send bytes that look like request ``number``, and have them ignored."""
    peer.raw(data)
    peer.listen(QUIET)
    peer.need(number not in peer.replies, f"no answer to {what}")
    peer.need(peer.request(Operation.GET).result == 0, f"GET answered after {what}")


def _get(peer: Peer, number: int) -> bytes:
    return REQUEST_HEAD.pack(number, Operation.GET)


def _mine(peer: Peer) -> tuple[int, int]:
    return (peer.hello.boot & 0xFF, peer.hello.session) if peer.hello else (0, 0)


def _stuff(body: bytes) -> bytes:
    return b"\0" + bytes(cobs.encode(body)) + b"\0"
