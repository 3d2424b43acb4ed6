"""Diagnosis of a faulty line from received bytes: flow control, translated line ends, 7 bits, baud rate, text.

Pure functions: equal bytes give equal sentences. Where a damaged frame becomes whole again (its CRC-32C is right) once
a suspected change is undone, that change is proven; only the rest is judged by statistics.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from enum import StrEnum
from itertools import combinations

import numpy as np
from cobs import cobs

from fabry_perot.wire.framing import OVERHEAD, VERSION, crc32c

XON, XOFF = 0x11, 0x13
MASKED = bytes([VERSION & 0x7F])
"""First byte of a frame whose top bits are gone."""
SHORT, MOST_PAIRS = 320, 112
"""Longest damaged frame, in bytes, into which one lost byte is put back, and two."""
EXAMINED = 24
"""Damaged frames examined."""
PAIRED = 2
"""Of these, those into which two bytes are put back."""
ENOUGH = 1024
"""Bytes of a line in use among which XON and XOFF are expected some eight times."""
_DEVICES = (
    (rb"marlin|echo:|ok T:|\bok\b.*\bB:", "a 3D printer with Marlin firmware"),
    (rb"grbl", "a motion controller with grbl firmware"),
    (rb"smoothie", "a motion controller with Smoothieware"),
    (rb"klipper", "a 3D printer with Klipper firmware"),
    (rb"HTTP/1\.|<html", "a web server"),
    (rb"SSH-\d", "an SSH server"),
    (rb"login:|password:", "a login prompt"),
    (rb"U-Boot|bootloader|ESP-ROM|ets [A-Z]", "a boot loader"),
)
"""What text tells its sender; compared without regard to case."""


class LineFault(StrEnum):
    """Kind of line fault, as diagnosed."""

    SILENCE = "silence"
    ECHO = "echo"
    OTHER_FRAMES = "other-frames"
    ZEROS = "zeros"
    CONSTANT = "constant"
    SEVEN_BITS = "seven-bits"
    TRANSLATED = "translated"
    FLOW_CONTROL = "flow-control"
    TEXT = "text"
    SLOWER = "slower"
    NOISE = "noise"
    DAMAGED = "damaged"
    """Whole frames and damaged ones, for no reason that the bytes tell."""
    UNANSWERED = "unanswered"
    """Whole frames only, but none that answers."""


def classify(data: bytes) -> LineFault:
    """Return the line fault that explains the bytes ``data`` received instead of the expected answer.

    Parameters
    ----------
    data
        Bytes as received, from whichever place in the stream; some kilobytes suffice.
    """
    if not data:
        return LineFault.SILENCE
    frames, chunks = _taken_apart(data)
    if any(kind < 0x80 for kind in frames):
        return LineFault.ECHO
    if not frames and other_version(data) is not None:
        return LineFault.OTHER_FRAMES
    if data.count(0) >= 0.98 * len(data):
        return LineFault.ZEROS
    if len(set(data)) == 1:
        return LineFault.CONSTANT
    if frames and not chunks:
        return LineFault.UNANSWERED
    damaged = chunks[:EXAMINED]
    masked = any(one[1:2] == MASKED for one in damaged)  # of any length: 0x80 becomes a delimiter
    if not frames and max(data) < 0x80 and masked and not _is_text(data):
        return LineFault.SEVEN_BITS
    if any(map(_was_translated, damaged)):
        return LineFault.TRANSLATED
    if any(map(_lost_flow_control, damaged)) or any(map(_lost_it_twice, damaged[:PAIRED])):
        return LineFault.FLOW_CONTROL
    if frames:
        stopped = len(data) >= ENOUGH and not {XON, XOFF} & set(data)
        return LineFault.FLOW_CONTROL if stopped else LineFault.DAMAGED
    if _is_text(data):
        return LineFault.TEXT
    return LineFault.SLOWER if _changes_seldom(data) else LineFault.NOISE


def explain(data: bytes, *, baud: int | None = None) -> str:
    """Return one clause with the diagnosis of a line and its remedy.

    Parameters
    ----------
    data
        As of :func:`classify`.
    baud
        Baud rate of the port in Bd; ``None`` where there is none to set, as at a socket.
    """
    trouble = classify(data)
    rate = f"another baud rate than {baud:,} Bd (PORT?baud=921600 sets it)" if baud else "another baud rate"
    match trouble:
        case LineFault.SILENCE:
            return f"nothing was received: it is off, at another port, has {rate} or 7 bits, or a wire is wrong"
        case LineFault.ECHO:
            return "the port echoes the sent bytes: a loop-back plug, or a terminal or adapter with echo"
        case LineFault.OTHER_FRAMES:
            return (
                f"its frames are of version 0x{other_version(data) or 0:02X}, those of this driver of 0x{VERSION:02X}:"
                " its firmware is older or newer than this driver"
            )
        case LineFault.ZEROS:
            return "only zero bytes came: the line is held low, as by a device without power or swapped wires"
        case LineFault.CONSTANT:
            return f"only the byte 0x{data[0]:02X} came, over and over: no scanner, or {rate}"
        case LineFault.SEVEN_BITS:
            return "the line carries 7 bits a byte: set 8 data bits and no parity everywhere on the way"
        case LineFault.TRANSLATED:
            return "the line changes line ends (CR, LF): set every program and server on the way to raw, binary"
        case LineFault.FLOW_CONTROL:
            return "the line takes XON and XOFF (0x11, 0x13) out of the data: turn software flow control off"
        case LineFault.TEXT:
            return f"text came from {_sender(data)} ({_first_line(data)!r}), no scanner"
        case LineFault.SLOWER:
            return f"the bytes look as if sent more slowly than they are read: {rate}, a lower one"
        case LineFault.NOISE:
            return f"bytes without any frame came: {rate}, or another device"
        case LineFault.DAMAGED:
            return "frames are damaged on the way: a bad cable, or a line that loses or changes bytes"
        case LineFault.UNANSWERED:
            return (
                "the scanner sends but does not answer: requests to it are lost or changed on the line"
                " (flow control, line ends, a wire)"
            )


def other_version(data: bytes) -> int | None:
    """Return the protocol version of frames of another version in ``data``; ``None`` if there are none.

    Their checksum is right, or would be with this driver's version byte.
    """
    for chunk in data.split(b"\0"):
        body = _body(chunk)
        if body is not None and body[0] != VERSION:
            return body[0]
        if body is None and len(chunk) > OVERHEAD and _is_frame(chunk[:1] + bytes([VERSION]) + chunk[2:]):
            return chunk[1]
    return None


def _taken_apart(data: bytes) -> tuple[list[int], list[bytes]]:
    """Split received bytes into the types of valid frames and the invalid chunks between delimiters."""
    kinds: list[int] = []
    damaged: list[bytes] = []
    first, *middle = data.split(b"\0")
    for at, chunk in enumerate([first, *middle[:-1]]):
        body = _body(chunk)
        if body is not None and body[0] == VERSION:
            kinds.append(body[1])
        elif chunk and at:
            damaged.append(chunk)
    if not middle:
        damaged = [first]
    return kinds, damaged


def _body(chunk: bytes) -> bytes | None:
    """Return header and payload of a frame of any protocol version; ``None`` for an invalid frame."""
    if len(chunk) <= OVERHEAD:
        return None
    try:
        body: bytes = cobs.decode(chunk)
    except cobs.DecodeError:
        return None
    sound = len(body) >= OVERHEAD and int.from_bytes(body[8:10], "little") == len(body) - OVERHEAD
    return body if sound and crc32c(body[:-4]) == int.from_bytes(body[-4:], "little") else None


def _is_frame(chunk: bytes) -> bool:
    body = _body(chunk)
    return body is not None and body[0] == VERSION


def _was_translated(chunk: bytes) -> bool:
    """Return whether a damaged frame becomes valid when translated line ends are restored."""
    return any(map(_is_frame, _untranslated(chunk)))


def _untranslated(chunk: bytes) -> Iterator[bytes]:
    if b"\r\n" in chunk:
        yield chunk.replace(b"\r\n", b"\n")
    for new, old in ((b"\n", b"\r"), (b"\r", b"\n")):  # all of one were made the other
        places = [at for at, byte in enumerate(chunk) if byte == new[0]][:10]
        for count in range(1, len(places) + 1):
            for some in combinations(places, count):
                changed = bytearray(chunk)
                for at in some:
                    changed[at] = old[0]
                yield bytes(changed)
    if b"\r" not in chunk and len(chunk) <= SHORT:  # CR is dropped
        yield from _with_one_more(chunk, b"\r")


def _lost_flow_control(chunk: bytes) -> bool:
    """Return whether a damaged frame becomes valid when XON or XOFF is inserted at one place."""
    if XON in chunk or XOFF in chunk or len(chunk) > SHORT:
        return False
    return any(_is_frame(one) for one in _with_one_more(chunk, bytes([XON, XOFF])))


def _lost_it_twice(chunk: bytes) -> bool:
    """Return whether a damaged frame becomes valid with two XON or XOFF insertions (50,000 pairs, 0.1 s)."""
    if XON in chunk or XOFF in chunk or len(chunk) > MOST_PAIRS:
        return False
    both = bytes([XON, XOFF])
    return any(_is_frame(two) for one in _with_one_more(chunk, both) for two in _with_one_more(one, both))


def _with_one_more(chunk: bytes, values: bytes) -> Iterator[bytes]:
    for at in range(len(chunk) + 1):
        for value in values:
            yield chunk[:at] + bytes([value]) + chunk[at:]


def _is_text(data: bytes) -> bool:
    printable = sum(0x20 <= byte < 0x7F or byte in b"\t\r\n" for byte in data)
    return printable >= 0.9 * len(data)


def _sender(data: bytes) -> str:
    return next((name for word, name in _DEVICES if re.search(word, data, re.IGNORECASE)), "another device")


def _first_line(data: bytes) -> str:
    lines = [line.strip() for line in re.split(rb"[\r\n]+", data) if line.strip()]
    told = next((line for line in lines if any(re.search(word, line, re.IGNORECASE) for word, _ in _DEVICES)), None)
    return (told or (lines[0] if lines else b""))[:60].decode("ascii", "replace")


def _changes_seldom(data: bytes) -> bool:
    """Return whether bits change as rarely as on a line sampled at too high a baud rate."""
    bits = np.unpackbits(np.frombuffer(data, np.uint8)).reshape(-1, 8)
    changes = (bits[:, 1:] != bits[:, :-1]).sum(axis=1)
    return len(data) >= 32 and float((changes <= 2).mean()) >= 0.85
