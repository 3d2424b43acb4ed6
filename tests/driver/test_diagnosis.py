"""What the bytes that came tell of a line: tables of what real lines do to real frames."""

from __future__ import annotations

import random

import pytest
from driver_lines import same, seven_bits, with_crlf, without_flow_control

from fabry_perot.host.diagnosis import LineFault, classify, explain, other_version
from fabry_perot.host.handshake import new_nonce
from fabry_perot.wire.constants import PROTOCOL, Type
from fabry_perot.wire.framing import Frame, encode_frame
from fabry_perot.wire.messages import Hello, HelloAck, Status, pack


def statuses(count: int = 40, boot: int = 1) -> bytes:
    """Return STATUS frames of an idle device, one each 0.1 s."""
    quiet = [0] * 13
    messages = [Status(12_345_678 + 100_000 * n, 0xB0070001, 1, 24, 0, 0, *quiet) for n in range(count)]
    return b"".join(encode_frame(Frame(Type.STATUS, 0, boot, 0x102, n, pack(one))) for n, one in enumerate(messages))


def answers(count: int = 18) -> bytes:
    """Return HELLO_ACK frames."""
    ack = HelloAck(77, 0xB0070001, 0x102, 2, 1, 1, 1, 641, 512, 900, 5, 0, 0, 0, 0, 0, 1_000_000)
    return b"".join(encode_frame(Frame(Type.HELLO_ACK, 0, 1, 0x102, n, pack(ack))) for n in range(count))


def read_at(data: bytes, sent: int, read: int) -> bytes:
    """Return what a UART reads at ``read`` Bd of bytes that another sends at ``sent`` Bd, 8N1."""
    bits = [bit for byte in data for bit in (0, *((byte >> n) & 1 for n in range(8)), 1)] + [1] * 20
    ratio, at, out = sent / read, 0.0, bytearray()
    while True:
        while int(at) < len(bits) and bits[int(at)]:
            at += 0.05
        if int(at + ratio * 9.5) >= len(bits):
            return bytes(out)
        out.append(sum(bits[int(at + ratio * (1.5 + n))] << n for n in range(8)))
        at += ratio * 9.5


def with_version(data: bytes, version: int) -> bytes:
    """Return frames whose version byte, and checksum, are another firmware's."""
    from cobs import cobs

    from fabry_perot.wire.framing import CRC, crc32c

    out = b""
    for chunk in filter(None, data.split(b"\0")):
        body = bytes([version]) + cobs.decode(chunk)[1:-4]
        out += b"\0" + cobs.encode(body + CRC.pack(crc32c(body))) + b"\0"
    return out


NOISE = random.Random(1).randbytes(4000)
MARLIN = b"start\necho: Marlin 2.1\nok T:20.1 /0.0\n"
HELLO = encode_frame(Frame(Type.HELLO, 0, 0, 0, 3, pack(Hello(PROTOCOL, PROTOCOL, 32768, 0x01020304))))
TABLE = [
    ("nothing", b"", LineFault.SILENCE, "nothing was received"),
    ("XON/XOFF of STATUS", without_flow_control(statuses()), LineFault.FLOW_CONTROL, "software flow control"),
    ("XON/XOFF of HELLO_ACK", without_flow_control(answers(40)), LineFault.FLOW_CONTROL, "software flow control"),
    ("LF to CR LF", with_crlf(statuses()), LineFault.TRANSLATED, "line ends"),
    ("LF to CR", statuses().replace(b"\n", b"\r"), LineFault.TRANSLATED, "line ends"),
    ("CR to LF", statuses().replace(b"\r", b"\n"), LineFault.TRANSLATED, "line ends"),
    ("CR dropped", statuses(60).replace(b"\r", b""), LineFault.TRANSLATED, "line ends"),
    ("7 bits", seven_bits(statuses()), LineFault.SEVEN_BITS, "8 data bits"),
    ("7 bits, 0x80 near the start", seven_bits(statuses(boot=0x80)), LineFault.SEVEN_BITS, "8 data bits"),
    ("7 bits of HELLO_ACK", seven_bits(answers()), LineFault.SEVEN_BITS, "8 data bits"),
    ("read too fast", read_at(statuses(), 921_600, 3_000_000), LineFault.SLOWER, "a lower one"),
    ("read much too fast", read_at(statuses(8), 115_200, 921_600), LineFault.SLOWER, "a lower one"),
    ("read too slowly", read_at(statuses(), 3_000_000, 921_600), LineFault.NOISE, "another baud rate than"),
    ("random bytes", NOISE, LineFault.NOISE, "or another device"),
    ("zeros", bytes(2000), LineFault.ZEROS, "only zero bytes"),
    ("nearly zeros", bytes(990) + b"\x80" * 10, LineFault.ZEROS, "only zero bytes"),
    ("one byte", b"\x55" * 2000, LineFault.CONSTANT, "0x55"),
    ("Marlin", 5 * MARLIN, LineFault.TEXT, "a 3D printer with Marlin firmware ('echo: Marlin 2.1')"),
    ("grbl", b"\r\nGrbl 1.1f ['$' for help]\r\n", LineFault.TEXT, "grbl firmware"),
    ("web server", b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n", LineFault.TEXT, "a web server"),
    ("log text", b"I (312) boot: done\r\nready\r\n", LineFault.TEXT, "another device ('I (312) boot: done')"),
    ("echo", 3 * HELLO, LineFault.ECHO, "echoes"),
    ("frame version 0xF0", with_version(answers(), 0xF0), LineFault.OTHER_FRAMES, "0xF0, those of this driver of 0xF1"),
    ("frame version 0xF2", with_version(answers(), 0xF2), LineFault.OTHER_FRAMES, "0xF2"),
    ("version byte alone", answers().replace(b"\xf1\x81", b"\xf0\x81"), LineFault.OTHER_FRAMES, "0xF0, those of this"),
    ("sound frames", statuses(), LineFault.UNANSWERED, "does not answer"),
    ("half a frame first", statuses()[40:], LineFault.UNANSWERED, "does not answer"),
    ("some changed bits", statuses().replace(b"\xb0", b"\xb1", 9), LineFault.DAMAGED, "frames are damaged"),
]


@pytest.mark.parametrize(("data", "trouble", "words"), [row[1:] for row in TABLE], ids=[row[0] for row in TABLE])
def test_classify_damaged_frames_returns_line_fault_and_explanation(data, trouble, words):
    assert classify(data) is trouble
    assert words in explain(data, baud=3_000_000)


@pytest.mark.parametrize("name", ["XON/XOFF of STATUS", "LF to CR LF", "7 bits", "read too fast"])
def test_classify_line_fault_is_independent_of_start_offset(name):
    data, trouble = next(row[1:3] for row in TABLE if row[0] == name)
    assert {classify(data[at:]) for at in range(0, 97, 8)} == {trouble}


def test_every_trouble_is_in_the_table_and_has_a_sentence_of_its_own():
    assert {row[2] for row in TABLE} == set(LineFault)
    first = {trouble: explain(next(row[1] for row in TABLE if row[2] is trouble)) for trouble in LineFault}
    assert len(set(first.values())) == len(LineFault)


def test_explain_without_a_baud_rate_names_none():
    assert "3,000,000" not in explain(NOISE)
    assert "another baud rate" in explain(NOISE)


def test_other_version_of_sound_frames_and_of_noise_is_none():
    assert other_version(statuses()) is None
    assert other_version(NOISE) is None


def test_new_nonce_puts_nothing_into_hello_that_a_line_changes():
    rules = (with_crlf, without_flow_control, same)
    for _ in range(50):
        nonce = new_nonce()
        hellos = [
            encode_frame(Frame(Type.HELLO, 0, 0, 0, n, pack(Hello(PROTOCOL, PROTOCOL, 32768, nonce))))
            for n in range(1, 19)
        ]
        unchanged = sum(all(rule(one) == one for rule in rules) for one in hellos)
        assert unchanged >= 6, "the rest have such a byte in sequence number or checksum"
