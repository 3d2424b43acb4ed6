"""A device's TCP port with several clients: one host, observers that stop it, a host that is frozen."""

from __future__ import annotations

import itertools
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import closing

import pytest
from driver_bench import CountingInstrument

import fabry_perot
from fabry_perot.device import Device
from fabry_perot.device.tcp import MOST_OBSERVERS, SILENCE, TcpEndpoint
from fabry_perot.host import HostTiming
from fabry_perot.host.host import Host
from fabry_perot.simulator import launch
from fabry_perot.wire.constants import PROTOCOL, AbortLevel, Type
from fabry_perot.wire.framing import Deframer, Frame, encode_frame
from fabry_perot.wire.messages import Abort, AbortAck, Hello, HelloAck, Status, pack, unpack
from fabry_perot.wire.states import DeviceState

DEADLINE = 60.0


def hello(nonce: int) -> bytes:
    return encode_frame(Frame(Type.HELLO, 0, 0, 0, 1, pack(Hello(PROTOCOL, PROTOCOL, 8192, nonce))))


def abort(number: int) -> bytes:
    return encode_frame(Frame(Type.ABORT, 2, 0, 0, 1, pack(Abort(AbortLevel.LASER_OFF, number))))


class Client:
    """A TCP client that reads whole frames; ``receive_buffer`` in bytes makes it full soon."""

    def __init__(self, url: str, receive_buffer: int = 0) -> None:
        host, _, port = url.removeprefix("socket://").rpartition(":")
        self.socket = socket.socket()
        if receive_buffer:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        try:
            self.socket.connect((host, int(port)))
        except OSError:
            self.socket.close()
            raise
        self.socket.setblocking(False)
        self._deframer, self.over = Deframer(), False

    def send(self, data: bytes) -> None:
        self.socket.sendall(data)

    def frames(self) -> list[Frame]:
        try:
            data = self.socket.recv(1 << 20)
        except BlockingIOError:
            return []
        self.over = not data
        return self._deframer.feed(data)


class Bench:
    """A device on a TCP endpoint whose clock the test sets."""

    def __init__(self) -> None:
        self.now = 100.0
        self.endpoint = TcpEndpoint("127.0.0.1:0", lambda: self.now)
        self.device = Device(CountingInstrument(), boot=0xB007)
        self.heard = b""
        self._out = b""
        self._clients: list[Client] = []

    def client(self, receive_buffer: int = 0) -> Client:
        self._clients.append(Client(self.endpoint.url, receive_buffer))
        return self._clients[-1]

    def connected(self, nonce: int = 1, receive_buffer: int = 0) -> Client:
        client = self.client(receive_buffer)
        client.send(hello(nonce))
        self.until(client, Type.HELLO_ACK)
        return client

    def close(self) -> None:
        self.endpoint.close()
        for client in self._clients:
            client.socket.close()

    def turn(self) -> None:
        self.now += 0.001
        self.heard += (data := self.endpoint.read(65536))
        self.device.receive(data, round(self.now * 1e6))
        self._out = self._out or self.device.next_frames(16384)
        self._out = self._out[self.endpoint.write(self._out) :]

    def until(self, client: Client, kind: Type) -> bytes:
        """Return the payload of the next frame of a type that a client gets."""
        return self.until_true(lambda: next((f.payload for f in client.frames() if f.type == kind), None))

    def until_true(self, found: Callable[[], bytes | bool | None]) -> bytes:
        deadline = time.monotonic() + DEADLINE
        while not (answer := found()):
            assert time.monotonic() < deadline
            self.turn()
        return bytes(answer) if isinstance(answer, bytes) else b""


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.close()


def test_observer_that_sends_abort_gets_abort_ack_and_status_while_a_host_is_connected(bench):
    host, observer = bench.connected(), bench.client()
    observer.send(abort(7))
    ack = unpack(AbortAck, bench.until(observer, Type.ABORT_ACK))
    assert (ack.number, ack.level) == (7, AbortLevel.LASER_OFF)
    assert unpack(Status, bench.until(observer, Type.STATUS)).boot == 0xB007
    bench.until(host, Type.STATUS)
    assert not observer.over


def test_client_without_hello_never_takes_the_place_of_the_host(bench):
    observer = bench.client()
    observer.send(abort(3))
    assert unpack(AbortAck, bench.until(observer, Type.ABORT_ACK)).number == 3
    host = bench.connected()
    observer.send(encode_frame(Frame(Type.REQ, 0, 7, 1, 1, b"\x01\x00\x04")) + abort(4))
    assert unpack(AbortAck, bench.until(observer, Type.ABORT_ACK)).number == 4
    assert b"\x03" not in {bytes([f.type]) for f in Deframer().feed(bench.heard)}, "requests of an observer pass"
    bench.until(host, Type.STATUS)


def test_tcp_observer_hello_with_connected_host_gets_busy_and_can_abort(bench):
    host, observer = bench.connected(), bench.client()
    observer.send(hello(2))
    name = bench.until(observer, Type.BUSY).decode()
    assert name == "{}:{}".format(*host.socket.getsockname())
    observer.send(abort(9))
    assert unpack(AbortAck, bench.until(observer, Type.ABORT_ACK)).number == 9


def test_host_that_is_silent_beyond_the_limit_is_replaced_by_the_next_hello(bench):
    frozen, other = bench.connected(), bench.client()
    other.send(hello(2))
    bench.until(other, Type.BUSY)
    bench.now += SILENCE
    other.send(hello(2))
    assert unpack(HelloAck, bench.until(other, Type.HELLO_ACK)).nonce == 2
    bench.until_true(lambda: frozen.frames() or frozen.over)
    bench.until_true(lambda: not frozen.frames() and frozen.over)


def test_host_that_sends_a_lone_zero_byte_in_time_is_not_replaced(bench):
    host, other = bench.connected(), bench.client()
    for _ in range(3):
        bench.now += 0.75 * SILENCE
        host.send(b"\0")
        bench.heard = b""
        bench.until_true(lambda: bench.heard)
    other.send(hello(2))
    bench.until(other, Type.BUSY)


def test_host_that_has_left_is_replaced_at_once_and_its_last_abort_is_heard(bench):
    leaving, other = bench.connected(), bench.client()
    bench.heard = b""
    leaving.send(abort(21))
    leaving.socket.close()
    other.send(hello(2))
    bench.until(other, Type.HELLO_ACK)
    kinds = [frame.type for frame in Deframer().feed(bench.heard)]
    assert kinds == [Type.ABORT, Type.HELLO]


def test_observers_abort_is_answered_while_the_host_reads_nothing(bench):
    bench.connected(receive_buffer=4096)
    deadline = time.monotonic() + DEADLINE
    while bench.endpoint.write(b"\x01" * 65536):  # nobody reads: the system's buffers fill
        assert time.monotonic() < deadline
    observer = bench.client()
    observer.send(abort(5))
    assert unpack(AbortAck, bench.until(observer, Type.ABORT_ACK)).number == 5
    bench.until(observer, Type.STATUS)


def test_host_that_neither_reads_nor_sends_beyond_the_limit_is_dropped(bench):
    bench.connected(receive_buffer=4096)
    deadline = time.monotonic() + DEADLINE
    while bench.endpoint.write(b"\x01" * 65536):
        assert time.monotonic() < deadline
    bench.now += 2 * SILENCE
    assert bench.endpoint.write(b"\x01" * 65536) == 65536
    assert bench.endpoint.writable_descriptor() is None


def test_one_observer_too_many_displaces_the_one_that_was_silent_for_longest(bench):
    observers = []
    for _ in range(MOST_OBSERVERS):
        observers.append(bench.client())
        bench.until_true(lambda: len(bench.endpoint.descriptors()) == 1 + len(observers))
    observers[0].send(abort(1))
    bench.until(observers[0], Type.ABORT_ACK)
    late = bench.client()
    late.send(abort(2))
    assert unpack(AbortAck, bench.until(late, Type.ABORT_ACK)).number == 2
    bench.until_true(lambda: not observers[1].frames() and observers[1].over)
    assert not any(one.over for one in observers if one is not observers[1])


def test_bytes_of_a_paced_line_that_takes_none_now_do_not_end_the_connection(bench):
    host = bench.connected()
    host.send(b"\0")
    assert bench.endpoint.read(0) == b""
    assert bench.endpoint.writable_descriptor() is not None


def test_host_that_has_nothing_to_send_sends_a_lone_zero_byte_once_a_second(bench):
    del bench
    device, host = Device(CountingInstrument(), boot=0xB007), Host(nonce=5, timing=HostTiming())
    host.open(0)
    sent: list[tuple[int, bytes]] = []
    for now in range(0, 6_000_000, 10_000):
        host.tick(now)
        if data := host.take_output():
            sent.append((now, data))
        device.receive(data, now)
        host.receive(device.next_frames(16384), now)
    idle = [at for at, data in sent if data == b"\0"]
    assert len(idle) >= 4
    assert all(later - earlier == 1_000_000 for earlier, later in itertools.pairwise(idle))
    assert device.deframer.counters.bad == 0


def test_scanner_in_another_process_is_stopped_by_an_observer_of_its_tcp_port():
    with launch(tcp="127.0.0.1:0") as simulator, fabry_perot.connect(simulator.url) as scanner:
        scanner.upload([(0.0, 0.0)] * 5000, samples=64, sampling_interval=8e-9, pulse_rate=100.0)
        scanner.start(scanner.arm())
        lines = iter(scanner.alines(idle=True))
        while not next(lines):
            pass
        observer = Client(simulator.url)
        with closing(observer.socket):
            observer.send(abort(11))
            with pytest.raises((fabry_perot.ScanAborted, fabry_perot.LeaseExpired)):  # the latter on a busy machine
                for _ in lines:
                    pass
            report = simulator.send_command("report", fired=False)
            assert (report["state"], report["shutter"]) == ("safe_hold", False)
            deadline, said = time.monotonic() + DEADLINE, list(observer.frames())
            while Type.STATUS not in [frame.type for frame in said[-1:]]:
                assert time.monotonic() < deadline
                said += observer.frames()
        assert Type.ABORT_ACK in {frame.type for frame in said}
        assert unpack(Status, said[-1].payload).state == DeviceState.SAFE_HOLD
