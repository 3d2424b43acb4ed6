"""Protocol messages: fixed little-endian structures for frequent ones, CBOR for capabilities and parameters.

Every fixed message is a ``NamedTuple`` whose fields stand in the order of its structure in :data:`LAYOUT`. A payload
of the wrong length raises :class:`~fabry_perot.errors.FrameError`; nothing is guessed from a short one.
"""

from __future__ import annotations

import struct
from typing import Any, NamedTuple, TypeVar

import cbor2
import numpy as np

from fabry_perot.errors import FrameError


class Hello(NamedTuple):
    """HELLO, host → device: request for a new session; ``nonce`` makes repetitions harmless."""

    oldest: int
    newest: int
    max_payload: int
    nonce: int


class HelloAck(NamedTuple):
    """HELLO_ACK, device → host: the new session, the device's buffer sizes, state and plan."""

    nonce: int
    boot: int
    session: int
    version: int
    reset_cause: int
    state: int
    lanes: int
    max_payload: int
    ring: int
    caps_size: int
    caps_crc: int
    plan: int
    length: int
    position: int
    produced: int
    acknowledged: int
    device_time: int


class PlanStatus(NamedTuple):
    """PLAN_STATUS, device → host: points are accepted from ``expected`` up to (not including) ``limit``."""

    plan: int
    expected: int
    limit: int
    retransmit: int


class ALineHead(NamedTuple):
    """Header of an ALINE frame, before one fragment of a blob (44-byte meta ‖ samples) or ``more`` + 1 whole blobs."""

    plan: int
    number: int
    point: int
    fragment: int
    fragments: int
    encoding: int
    more: int


class ALineMeta(NamedTuple):
    """Metadata of an A-line: the first 44 bytes of its blob."""

    fire_time: int
    wavelength: int
    shot: int
    crc: int
    scale: float
    interval: int
    samples: int
    averages: int
    energy: int
    dc: int
    gain: int
    quality: int
    time_zero: int


class ALineAck(NamedTuple):
    """ALINE_ACK, host → device: A-lines below ``durable`` are stored, below ``limit`` may come; missing ones follow."""

    plan: int
    durable: int
    limit: int


class ALineGone(NamedTuple):
    """ALINE_GONE, device → host: A-lines ``first`` … ``first + lines − 1`` are lost and will not be sent."""

    plan: int
    first: int
    lines: int
    reason: int


class Status(NamedTuple):
    """STATUS, device → host, at 10 Hz and on change: state, laser, plan position, A-lines and shots."""

    device_time: int
    boot: int
    state: int
    laser: int
    cause: int
    fault: int
    lease_left: int
    plan: int
    position: int
    produced: int
    sent: int
    acknowledged: int
    shots: int
    shots_wasted: int
    last_shot: int
    lease_until: int
    x: int
    y: int
    bad_frames: int


class Lease(NamedTuple):
    """LEASE, host → device: echo of the device's time; permits emission until min(echo, now) + min(TTL, cap)."""

    boot: int
    echo: int
    ttl: int


class Abort(NamedTuple):
    """ABORT, host → device, valid in any session: level and number of an abort."""

    level: int
    number: int


class AbortAck(NamedTuple):
    """ABORT_ACK, device → host: acknowledgement of an abort, with the state that it caused."""

    level: int
    number: int
    state: int


class Fault(NamedTuple):
    """FAULT, device → host, repeated until the host acknowledges with the same structure."""

    code: int
    number: int


POINT = np.dtype(
    [
        ("x", "<i4"),
        ("y", "<i4"),
        ("wavelength", "<u4"),
        ("averages", "<u2"),
        ("flags", "u1"),
        ("settle", "u1"),
    ]
)
"""A point of a plan: x, y in nm on the film, bias wavelength in pm (0: the device's map), settle in 100 µs."""

LAYOUT: dict[type[Any], struct.Struct] = {
    Hello: struct.Struct("<BBHI"),
    HelloAck: struct.Struct("<IIHBBBBHHHIIIIIIQ"),
    PlanStatus: struct.Struct("<IIIB"),
    ALineHead: struct.Struct("<IIIBBBB"),
    ALineMeta: struct.Struct("<QIIIfIHHHhhBxi"),
    ALineAck: struct.Struct("<III"),
    ALineGone: struct.Struct("<IIIB"),
    Status: struct.Struct("<QIBBBBHIIIIIIIQQiiI"),
    Lease: struct.Struct("<IQI"),
    Abort: struct.Struct("<BI"),
    AbortAck: struct.Struct("<BIB"),
    Fault: struct.Struct("<HI"),
}
MISSING = struct.Struct("<IB")
CAPS_REQUEST = struct.Struct("<H")
CAPS_HEAD = struct.Struct("<HH")
REQUEST_HEAD = struct.Struct("<HB")
REPLY_HEAD = struct.Struct("<HBBB")
PLAN_HEAD = struct.Struct("<IIH")

T = TypeVar("T")


def pack(message: tuple[Any, ...]) -> bytes:
    """Return the encoded bytes of a fixed message."""
    return LAYOUT[type(message)].pack(*message)


def unpack(kind: type[T], payload: bytes, *, tail: bool = False) -> T:
    """Decode the fixed message at the start of ``payload``.

    Parameters
    ----------
    kind
        The message's class.
    payload
        The bytes.
    tail
        More bytes may follow.

    Raises
    ------
    FrameError
        ``payload`` has the wrong length.
    """
    layout = LAYOUT[kind]
    return kind(*unpack_exact(layout, payload, tail=tail))


def unpack_exact(layout: struct.Struct, payload: bytes, *, tail: bool = False) -> tuple[Any, ...]:
    """Parse the fields of ``layout`` at the start of ``payload``; a wrong length raises FrameError."""
    if len(payload) < layout.size or (len(payload) > layout.size and not tail):
        raise FrameError(f"{len(payload)} bytes where the message has {layout.size}")
    return layout.unpack_from(payload)


def pack_body(value: object) -> bytes:
    """Return parameters encoded as CBOR."""
    return cbor2.dumps(value, canonical=True)


def unpack_body(data: bytes) -> dict[str, Any]:
    """Return the parameters in CBOR ``data``, empty for no bytes; anything but a map raises FrameError."""
    if not data:
        return {}
    try:
        value = cbor2.loads(data)
    except (cbor2.CBORDecodeError, ValueError, OverflowError, RecursionError, MemoryError) as error:
        raise FrameError(f"not CBOR: {error}") from error
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise FrameError("parameters are not a map with text keys")
    return value
