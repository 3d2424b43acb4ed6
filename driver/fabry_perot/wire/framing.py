r"""Framing of messages on the line: ``00 · COBS(header ‖ payload ‖ CRC-32C) · 00``.

Consistent-overhead byte stuffing keeps zero out of a frame, so a receiver that lost its place finds it again at the
next zero. The header repeats the payload's length because a corrupted stuffing byte can shorten a frame in ways a CRC
alone was not made for. All integers are little endian.

======  =====  =========================================================================
offset  type   field
======  =====  =========================================================================
0       u8     version, 0xF1
1       u8     message type; bit 7 set: from device to host
2       u8     flags: bit 0 retransmission, bit 1 urgent; an unknown bit of 4–7 drops the frame
3       u8     boot tag: low byte of the device's boot id (0 before a session)
4       u16    session (0 before a session)
6       u16    frame sequence number, for statistics only
8       u16    payload length in bytes
10      …      payload
10 + n  u32    CRC-32C of header and payload
======  =====  =========================================================================
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import NamedTuple

import google_crc32c
from cobs import cobs

from fabry_perot.errors import FrameError

VERSION = 0xF1
HEADER = struct.Struct("<BBBBHHH")
CRC = struct.Struct("<I")
OVERHEAD = HEADER.size + CRC.size
MAX_PAYLOAD = 32768
"""Largest payload on any line, in bytes; for TCP, which has a checksum of its own."""
USB_PAYLOAD = 8192
"""Largest payload on USB and other lines without one: a bit error costs no more than that."""
UART_PAYLOAD = 641
"""Largest payload on a UART: CRC-32C keeps a Hamming distance of 6 up to 655 bytes of header, payload and CRC."""

CRC_RESIDUE = 0x48674BC7
"""CRC-32C of anything followed by its own CRC-32C: checking a frame needs no copy without its last bytes."""

FLAG_RETRANSMISSION = 0x01
FLAG_URGENT = 0x02
_CRITICAL_UNKNOWN = 0xF0


class Frame(NamedTuple):
    """Decoded frame: header fields and payload."""

    type: int
    flags: int
    boot: int
    session: int
    sequence: int
    payload: bytes


@dataclass(slots=True)
class LinkCounters:
    """Counters of a deframer: frames unless stated otherwise."""

    good: int = 0
    bad_stuffing: int = 0
    bad_crc: int = 0
    bad_length: int = 0
    bad_version: int = 0
    unknown_critical: int = 0
    oversize: int = 0
    sequence_gaps: int = 0
    bytes_in: int = 0

    @property
    def bad(self) -> int:
        """Number of frames that were dropped."""
        return (
            self.bad_stuffing
            + self.bad_crc
            + self.bad_length
            + self.bad_version
            + self.unknown_critical
            + self.oversize
        )


def crc32c(data: bytes) -> int:
    """Return the CRC-32C (Castagnoli) of ``data``."""
    return int(google_crc32c.value(data))


def has_native_cobs() -> bool:
    """Return whether the C implementation of COBS is available; pure Python is about a hundred times slower."""
    return bool(getattr(cobs, "_using_extension", True))


def encode_frame(frame: Frame) -> bytes:
    """Return the encoded bytes of ``frame``, with both delimiters.

    Raises
    ------
    FrameError
        The payload is longer than :data:`MAX_PAYLOAD`.
    """
    if len(frame.payload) > MAX_PAYLOAD:
        raise FrameError(f"payload of {len(frame.payload)} bytes; allowed: at most {MAX_PAYLOAD}")
    head = HEADER.pack(VERSION, frame.type, frame.flags, frame.boot, frame.session, frame.sequence, len(frame.payload))
    body = head + frame.payload
    return b"\0" + bytes(cobs.encode(body + CRC.pack(crc32c(body)))) + b"\0"


def encoded_size(payload: int) -> int:
    """Return the largest number of encoded bytes for a payload of ``payload`` bytes."""
    body = payload + OVERHEAD
    return body + body // 254 + 3


@dataclass(slots=True)
class Deframer:
    """Incremental frame decoder that resynchronises at every zero byte.

    Parameters
    ----------
    max_payload
        Longer frames are dropped and counted, so memory stays bounded on a line full of noise.
    """

    max_payload: int = MAX_PAYLOAD
    counters: LinkCounters = field(default_factory=LinkCounters)
    _pending: bytearray = field(default_factory=bytearray)
    _skipping: bool = False
    _next_sequence: int = -1
    _longest: int = 0

    def __post_init__(self) -> None:
        self._longest = encoded_size(self.max_payload)

    def feed(self, data: bytes) -> list[Frame]:
        """Process received bytes and return the frames they complete, in order."""
        self.counters.bytes_in += len(data)
        frames: list[Frame] = []
        start, end = 0, data.find(b"\0")  # a search for one byte is many times faster than split()
        while end >= 0:
            chunk = data[start:end]
            if self._pending:
                self._pending += chunk
                chunk = bytes(self._pending)
                self._pending.clear()
            start, end = end + 1, data.find(b"\0", end + 1)
            if self._skipping:
                self._skipping = False
            elif chunk:
                frame = self._decode(chunk)
                if frame is not None:
                    frames.append(frame)
        self._pending += data[start:]
        if len(self._pending) > self._longest:
            self.counters.oversize += not self._skipping
            self._skipping = True
            self._pending.clear()
        return frames

    def _decode(self, chunk: bytes) -> Frame | None:
        counters = self.counters
        if len(chunk) > self._longest:
            counters.oversize += 1
            return None
        try:
            body: bytes = cobs.decode(chunk)
        except cobs.DecodeError:
            counters.bad_stuffing += 1
            return None
        if len(body) < OVERHEAD:
            counters.bad_length += 1
            return None
        version, kind, flags, boot, session, sequence, length = HEADER.unpack_from(body)
        if length != len(body) - OVERHEAD:
            counters.bad_length += 1
        elif google_crc32c.value(body) != CRC_RESIDUE:
            counters.bad_crc += 1
        elif version != VERSION:
            counters.bad_version += 1
        elif flags & _CRITICAL_UNKNOWN:
            counters.unknown_critical += 1
        else:
            counters.good += 1
            if sequence != self._next_sequence >= 0:
                counters.sequence_gaps += 1
            self._next_sequence = (sequence + 1) & 0xFFFF
            return Frame(kind, flags, boot, session, sequence, body[HEADER.size : -4])
        return None
