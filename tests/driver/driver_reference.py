"""A second reading of PROTOCOL.md: a decoder that shares no line with the driver, only ``struct`` and the document."""

from __future__ import annotations

import struct


def _crc_table() -> list[int]:
    table = []
    for byte in range(256):
        for _ in range(8):
            byte = (byte >> 1) ^ (0x82F63B78 if byte & 1 else 0)
        table.append(byte)
    return table


_TABLE = _crc_table()


def castagnoli(data: bytes) -> int:
    value = 0xFFFFFFFF
    for byte in data:
        value = (value >> 8) ^ _TABLE[(value ^ byte) & 0xFF]
    return value ^ 0xFFFFFFFF


def unstuff(chunk: bytes) -> bytes | None:
    """Undo COBS; ``None`` when the bytes cannot be a stuffed frame."""
    out, at = bytearray(), 0
    while at < len(chunk):
        code = chunk[at]
        if at + code > len(chunk):
            return None
        out += chunk[at + 1 : at + code]
        at += code
        if code < 255 and at < len(chunk):
            out.append(0)
    return bytes(out)


def frames(data: bytes) -> list[dict]:
    """All valid frames in recorded bytes."""
    found = []
    for chunk in data.split(b"\0"):
        body = unstuff(chunk) if chunk else None
        if body is None or len(body) < 14:
            continue
        version, kind, flags, boot, session, sequence, size = struct.unpack_from("<BBBBHHH", body)
        payload, crc = body[10:-4], struct.unpack_from("<I", body, len(body) - 4)[0]
        if version == 0xF1 and size == len(payload) and crc == castagnoli(body[:-4]) and not flags & 0xF0:
            found.append({"type": kind, "boot": boot, "session": session, "sequence": sequence, "payload": payload})
    return found


def rice(data: bytes, count: int) -> list[int]:
    """Encoding 1, bit by bit as the document describes it."""
    blocks = -(-count // 32)
    parameters = data[:blocks]
    width = [parameters[i // 32] for i in range(count)]
    bits = [(byte >> shift) & 1 for byte in data[blocks:] for shift in range(7, -1, -1)]
    at, low = 0, []
    for k in width:
        value = 0
        for bit in bits[at : at + k]:
            value = value * 2 + bit
        at += k
        low.append(value)
    at = -(-at // 8) * 8
    samples, last = [], 0
    for k, rest in zip(width, low, strict=True):
        quotient = 0
        while not bits[at]:
            quotient, at = quotient + 1, at + 1
        at += 1
        u = quotient << k | rest
        last += u // 2 if u % 2 == 0 else -(u + 1) // 2
        samples.append(last)
    return samples


class ALines:
    """Puts A-lines together from ALINE frames and checks their samples' checksum."""

    def __init__(self) -> None:
        self.parts: dict[tuple[int, int], dict[int, bytes]] = {}
        self.lines: dict[tuple[int, int], dict] = {}

    def take(self, frame: dict) -> None:
        if frame["type"] != 0xA0:
            return
        plan, number, point, fragment, fragments, encoding, more = struct.unpack_from("<IIIBBBB", frame["payload"])
        if more:
            size = (len(frame["payload"]) - 16) // (more + 1)
            for i in range(more + 1):
                blob = frame["payload"][16 + i * size : 16 + (i + 1) * size]
                self.lines[plan, number + i] = {"point": point + i, **self.meta(blob, encoding)}
            return
        parts = self.parts.setdefault((plan, number), {})
        parts[fragment] = frame["payload"][16:]
        if len(parts) == fragments:
            blob = b"".join(parts[i] for i in range(fragments))
            self.lines[plan, number] = {"point": point, **self.meta(blob, encoding)}

    @staticmethod
    def meta(blob: bytes, encoding: int) -> dict:
        names = "fire wavelength shot crc scale interval samples averages energy dc gain quality time_zero".split()
        meta = dict(zip(names, struct.unpack_from("<QIIIfIHHHhhBxi", blob), strict=True))
        count, data = meta["samples"], blob[44:]
        values = list(struct.unpack(f"<{count}h", data)) if encoding == 0 else rice(data, count)
        assert castagnoli(struct.pack(f"<{count}h", *values)) == meta["crc"]
        return {**meta, "values": values}
