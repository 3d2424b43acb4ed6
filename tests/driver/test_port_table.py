"""Ports at which no scanner can be asked: each row of the table has its own error, which says what is the matter."""

from __future__ import annotations

import errno
import fcntl
import http.server
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path

import pytest
from driver_lines import line, same, seven_bits, stranger, with_crlf, without_flow_control
from test_diagnosis import MARLIN, NOISE, read_at, statuses, with_version

import fabry_perot
from fabry_perot import PlanInvalid, PortBusy, PortForbidden, PortUnavailable, ResponseTimeout, ScannerError
from fabry_perot.errors import LinkLost, ProtocolMismatch
from fabry_perot.host import HostTiming, port_usage
from fabry_perot.host.transport import open_transport
from fabry_perot.simulator import launch
from fabry_perot.wire.constants import Type
from fabry_perot.wire.framing import Deframer, Frame, encode_frame
from fabry_perot.wire.messages import Hello, HelloAck, pack, unpack
from support import copies

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals")
EAGER = HostTiming(hello_period=40_000, hello_tries=25, request_period=200_000, connect=1_500_000)
"""The same tries in a fifth of the time."""
Port = Callable[[ExitStack, Path, str], str]
"""Makes a port: given what ends with the test, a folder, a simulated scanner's port; returns the URL."""


def firmware(answered: int, *, named: int = 0, frame: int = 0xF1) -> Callable[[bytes], bytes]:
    """Return a device of another protocol version.

    Parameters
    ----------
    answered
        Version in its answer to HELLO of version 2.
    named
        Version in its answer to HELLO of any version; 0: likewise ``answered``.
    frame
        Version byte of its frames.
    """
    deframer = Deframer()

    def answer(data: bytes) -> bytes:
        out = b""
        for one in deframer.feed(data):
            if one.type == Type.HELLO:
                hello = unpack(Hello, one.payload)
                version = named if named and hello.oldest < 2 else answered
                ack = HelloAck(hello.nonce, 0xB007, 0x102, version, 1, 1, 1, 641, 512, 0, 0, 0, 0, 0, 0, 0, 1_000_000)
                out += encode_frame(Frame(Type.HELLO_ACK, 0, 7, 0x102, one.sequence, pack(ack)))
        return out if frame == 0xF1 else with_version(out, frame)

    return answer


def at(name: str) -> Port:
    return lambda stack, folder, scanner: name.replace("FOLDER", str(folder))


def sends(say: bytes, answer: Callable[[bytes], bytes] = lambda data: b"", period: float = 0.02) -> Port:
    return lambda stack, folder, scanner: stack.enter_context(stranger(lambda: say, answer, period))


def answers(make: Callable[[], Callable[[bytes], bytes]]) -> Port:
    return lambda stack, folder, scanner: stack.enter_context(stranger(answer=make()))


def through(up: Callable[[bytes], bytes], down: Callable[[bytes], bytes]) -> Port:
    """Return a port behind which is a scanner that has had a session, so that it sends STATUS by itself."""

    def make(stack: ExitStack, folder: Path, scanner: str) -> str:
        fabry_perot.connect(scanner).close()
        return stack.enter_context(line(scanner, up, down)).url

    return make


class LingeringHandler(http.server.BaseHTTPRequestHandler):
    """Handler that reads what still comes after its answer, as nginx does: else the answer may be lost in a reset."""

    def finish(self) -> None:
        super().finish()
        self.connection.shutdown(socket.SHUT_WR)
        self.connection.settimeout(10)
        while self.connection.recv(65536):
            pass

    def log_message(self, *_: object) -> None:
        pass


def web_server(stack: ExitStack, folder: Path, scanner: str) -> str:
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), LingeringHandler)
    stack.callback(server.server_close)
    stack.callback(server.shutdown)
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    return f"socket://127.0.0.1:{server.server_address[1]}"


def silent_server(stack: ExitStack, folder: Path, scanner: str) -> str:
    server = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
    return f"socket://127.0.0.1:{server.getsockname()[1]}"


def nobody(stack: ExitStack, folder: Path, scanner: str) -> str:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return f"socket://127.0.0.1:{server.getsockname()[1]}"


HOLDER = """
import fcntl, os, sys, termios
port = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
if sys.argv[2] == "lock":
    fcntl.flock(port, fcntl.LOCK_EX)
elif sys.argv[2] == "claim":
    fcntl.ioctl(port, termios.TIOCEXCL)
print("held", flush=True)
sys.stdin.read()
"""


def held(how: str) -> Port:
    """Return a port that another program has open: locked, claimed (TIOCEXCL) or merely open."""

    def make(stack: ExitStack, folder: Path, scanner: str) -> str:
        url = stack.enter_context(stranger())
        command = [sys.executable, "-c", HOLDER, url, how]
        program = stack.enter_context(copies.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE))
        assert program.stdout is not None
        assert program.stdout.readline() == b"held\n"
        (folder / "holder").write_text(f"(process {program.pid})")
        stack.callback(program.kill)
        return url

    return make


TABLE: list[tuple[str, Port, type[ScannerError], str]] = [
    ("no such file", at("FOLDER/ttyUSB7"), PortUnavailable, "no such file"),
    ("folder", at("FOLDER"), PortUnavailable, "not a serial port but a folder"),
    ("plain file", at(__file__), PortUnavailable, "not a serial port but a file"),
    ("/dev/null", at("/dev/null"), PortUnavailable, "not a serial port but another kind of device"),
    ("no name", at(""), PortUnavailable, "no port is given"),
    ("silence", sends(b""), ResponseTimeout, "nothing was received: it is off"),
    (
        "random bytes",
        sends(NOISE[:400]),
        ResponseTimeout,
        "bytes without any frame came: another baud rate than 3,000,000",
    ),
    ("flood", sends(NOISE, period=0.0005), ResponseTimeout, "bytes without any frame came"),
    (
        "read too fast",
        sends(read_at(statuses(3), 921_600, 3_000_000)),
        ResponseTimeout,
        "more slowly than they are read",
    ),
    ("zeros", sends(bytes(2000)), ResponseTimeout, "only zero bytes came"),
    ("one byte", sends(b"\x55" * 2000), ResponseTimeout, "only the byte 0x55 came"),
    ("Marlin", sends(MARLIN), ResponseTimeout, "a 3D printer with Marlin firmware ('echo: Marlin 2.1')"),
    ("grbl", sends(b"Grbl 1.1f ['$' for help]\r\n"), ResponseTimeout, "a motion controller with grbl firmware"),
    ("echo", answers(lambda: same), ResponseTimeout, "the port echoes the sent bytes"),
    (
        "XON/XOFF",
        through(without_flow_control, without_flow_control),
        ResponseTimeout,
        "turn software flow control off",
    ),
    ("CR LF", through(with_crlf, with_crlf), ResponseTimeout, "the line changes line ends"),
    ("7 bits", through(seven_bits, seven_bits), ResponseTimeout, "the line carries 7 bits a byte"),
    ("deaf", through(lambda data: b"", same), ResponseTimeout, "the scanner sends but does not answer"),
    ("version 1", answers(lambda: firmware(1)), ProtocolMismatch, "protocol version 1, this driver version 2"),
    ("version 3", answers(lambda: firmware(3)), ProtocolMismatch, "protocol version 3, this driver version 2"),
    ("version 0, then 4", answers(lambda: firmware(0, named=4)), ProtocolMismatch, "speaks protocol version 4"),
    ("version 0", answers(lambda: firmware(0)), ProtocolMismatch, "does not state its own"),
    ("frames 0xF0", answers(lambda: firmware(2, frame=0xF0)), ProtocolMismatch, "of version 0xF0, those of this"),
    ("locked", held("lock"), PortBusy, "is in use by HOLDER"),
    ("claimed", held("claim"), PortBusy, "is in use by HOLDER"),
    ("open elsewhere", held("open"), ResponseTimeout, "HOLDER has PORT open as well"),
    ("TCP, nobody", nobody, PortUnavailable, "nothing listens there"),
    ("TCP, web server", web_server, PortUnavailable, "text came from a web server"),
    (
        "TCP, silence",
        silent_server,
        ResponseTimeout,
        "nothing was received: it is off, at another port, has another baud",
    ),
    ("TCP, no port", at("socket://127.0.0.1"), PortUnavailable, "it names no port number"),
    ("TCP, no host", at("socket://:4001"), PortUnavailable, "it names no host"),
    ("TCP, space", at("socket://127.0.0.1: 4001"), PortUnavailable, "the URL has the form socket://HOST:PORT"),
    ("scheme", at("sockets://127.0.0.1:4001"), PortUnavailable, "protocol 'sockets' not known"),
    ("baud rate 7", at("/dev/null?baud=7"), PlanInvalid, "baud is 7; allowed: 1,200 … 20,000,000 Bd"),
    ("baud rate fast", at("/dev/null?baud=fast"), PlanInvalid, "baud is fast; allowed: 1,200"),
]


@pytest.fixture(scope="module")
def scanner() -> Iterator[str]:
    with launch(speed=20) as simulator:
        yield simulator.url


def ask(url: str) -> None:
    """Connect, and make requests until one is not answered."""
    with fabry_perot.connect(url, timing=EAGER, recovery=None) as found:
        for _ in range(200):
            found.statistics()


@pytest.mark.parametrize(("make", "error", "words"), [row[1:] for row in TABLE], ids=[row[0] for row in TABLE])
def test_port_that_is_no_scanner_has_an_error_of_its_own(make, error, words, scanner, tmp_path):
    with ExitStack() as stack:
        url = make(stack, tmp_path, scanner)
        with pytest.raises(ScannerError) as raised:
            ask(url)
    holder = (tmp_path / "holder").read_text() if "HOLDER" in words else ""
    assert type(raised.value) is error, raised.value
    for part in words.replace("PORT", url).split("HOLDER") if holder else [words]:
        assert part in str(raised.value)
    assert holder in str(raised.value)


def test_error_of_a_bad_line_counts_bytes_and_frames(scanner):
    fabry_perot.connect(scanner).close()
    with line(scanner, down=seven_bits) as bad, pytest.raises(ResponseTimeout, match=r"[\d,]+ bytes in \d") as raised:
        fabry_perot.connect(bad.url, timing=EAGER)
    assert "0 valid frames" in str(raised.value)


def test_every_error_of_a_port_is_worded_differently():
    assert len({row[3] for row in TABLE}) >= len(TABLE) - 1  # of two kinds of noise


def test_default_limits_end_a_greeting_within_six_seconds():
    timing = HostTiming()
    assert timing.hello_period * timing.hello_tries <= 5_000_000
    assert timing.connect <= 5_000_000
    assert timing.request_period * timing.request_tries <= 5_000_000


def test_bytes_before_the_end_of_a_connection_are_read_whenever_it_comes():
    with socket.create_server(("127.0.0.1", 0)) as server:
        host, port = server.getsockname()

        def send_and_leave(seconds: float) -> None:
            connection, _ = server.accept()
            with connection:
                connection.recv(1)  # opening a port drops what came before
                connection.sendall(b"HTTP/1.0 400\n")
                time.sleep(seconds)

        for milliseconds in (0, 0.5, 1, 1.5, 2, 3):
            peer = threading.Thread(target=send_and_leave, args=(milliseconds * 1e-3,))
            peer.start()
            read = b""
            with closing(open_transport(f"socket://{host}:{port}")) as line, suppress(LinkLost):
                line.write(b"?")
                while True:
                    read += line.read()
            peer.join()
            assert read == b"HTTP/1.0 400\n"


@contextmanager
def another_user() -> Iterator[None]:
    """Be a user without rights, where this one has all."""
    before = os.geteuid()
    if before == 0:
        os.seteuid(12345)
    try:
        yield
    finally:
        os.seteuid(before)


def test_port_without_permission_names_file_group_and_remedy_and_is_not_in_use():
    with stranger() as url:
        if os.geteuid() == 0:
            import grp

            group = grp.getgrall()[-1]
            os.chown(url, 0, group.gr_gid)
            os.chmod(url, 0o660)
            remedy = f"usermod -aG {group.gr_name} "
        else:
            os.chmod(url, 0)
            remedy = "udev rule"
        with another_user(), pytest.raises(PortForbidden) as raised:
            open_transport(url)
        with another_user():
            (found,) = fabry_perot.discover([url], probe=True)
    said = str(raised.value)
    assert url in said
    assert "group" in said
    assert remedy in said
    assert "in use" not in said
    assert (found.busy, found.reason) == (False, said)


def test_port_without_permission_is_busy_on_windows(monkeypatch):
    from fabry_perot.host import transport

    def refuse(*_, **__):
        raise PermissionError(errno.EACCES, "Access is denied")

    monkeypatch.setattr(transport.serial, "Serial", refuse)
    monkeypatch.setattr(transport.sys, "platform", "win32")
    with pytest.raises(PortBusy):
        open_transport("COM3")


def test_discover_reports_scanner_or_reason_for_each_port(scanner, tmp_path):
    with ExitStack() as stack:
        busy, old = held("lock")(stack, tmp_path, scanner), answers(lambda: firmware(0, named=3))(stack, tmp_path, "")
        quiet = sends(b"")(stack, tmp_path, scanner)
        urls = [scanner, busy, old, quiet]
        found = {one.url: one for one in fabry_perot.discover(urls, probe=True, silent=True)}
        assert set(urls) - {one.url for one in fabry_perot.discover(urls, probe=True)} == {quiet}
    assert found[scanner].model
    assert (tmp_path / "holder").read_text() in found[busy].holder
    assert found[busy].busy
    assert "protocol version 3" in found[old].reason
    assert "nothing was received" in found[quiet].reason


def test_baud_rate_of_a_port_sets_the_line_and_counts_more_than_the_argument():
    with stranger() as url:
        for spelling, argument, expected in ((f"{url}?baud=921600", 115_200, 921_600), (url, 460_800, 460_800)):
            with closing(open_transport(spelling, argument)) as port:
                assert port.baudrate == expected
                said = subprocess.run(["stty", "-F", url], capture_output=True, text=True, check=True).stdout
                assert said.startswith(f"speed {expected} baud")


def test_names_of_a_port_are_the_same_with_and_without_a_baud_rate():
    with stranger() as url:
        assert port_usage.aliases(f"{url}?baud=921600") == port_usage.aliases(url)
        with open(url, "rb+", buffering=0) as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            assert port_usage.lock_owner(f"{url}?baud=921600") == port_usage.lock_owner(url) == os.getpid()
