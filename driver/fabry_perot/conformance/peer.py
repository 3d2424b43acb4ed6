"""Scripted host for conformance tests: sends arbitrary frames, valid or invalid, and records received frames."""

from __future__ import annotations

import secrets
from collections import defaultdict
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from fabry_perot.clock import Clock, RealClock
from fabry_perot.errors import FrameError
from fabry_perot.host.transport import Transport
from fabry_perot.wire.constants import PROTOCOL, AbortLevel, Operation, Type
from fabry_perot.wire.framing import FLAG_RETRANSMISSION, MAX_PAYLOAD, Deframer, Frame, crc32c, encode_frame
from fabry_perot.wire.messages import (
    CAPS_HEAD,
    CAPS_REQUEST,
    MISSING,
    PLAN_HEAD,
    POINT,
    REPLY_HEAD,
    REQUEST_HEAD,
    Abort,
    AbortAck,
    ALineAck,
    ALineHead,
    Fault,
    Hello,
    HelloAck,
    Lease,
    PlanStatus,
    Status,
    pack,
    pack_body,
    unpack,
    unpack_body,
    unpack_exact,
)
from fabry_perot.wire.states import RUNNING, DeviceState

QUIET_PERIOD = 0.3
"""Seconds in which a device has answered, if it answers at all."""
REPLY = 3.0
"""Seconds a request, repeated every half second, may take."""


RETRY_INTERVAL = 250_000
"""µs without progress after which points are offered again."""


class Failed(Exception):
    """The device does not behave as the protocol document requires."""


class Reply(NamedTuple):
    """Reply of the device to a request: result code and parameters."""

    result: int
    state: int
    body: dict[str, Any]


class ConformanceHost:
    """Scripted host side of the protocol, for conformance tests.

    Parameters
    ----------
    transport
        The open port.
    clock
        Host time.
    """

    def __init__(self, transport: Transport, clock: Clock | None = None) -> None:
        self._transport, self._clock = transport, clock or RealClock()
        self._deframer = Deframer()
        self._sequence = self._number = self._aborts = 0
        self.hello: HelloAck | None = None
        self.status: Status | None = None
        self.plan_status: PlanStatus | None = None
        self.limits: dict[str, Any] = {}
        self.caps = b""
        self.nonce = 0
        self.plan = secrets.randbelow(1 << 31)
        self._uploading = np.zeros(0, POINT)
        self._offered = self._offered_at = 0
        self._looked_at = self._clock.now()
        self.absence = 0.0
        """Longest time in s that this host itself did not look at the line."""
        self.renewing = False
        """Whether each STATUS is answered by a LEASE."""
        self.frames: list[Frame] = []
        """All that came since :meth:`forget`."""
        self.replies: dict[int, Reply] = {}
        self.fragments: defaultdict[int, dict[int, bytes]] = defaultdict(dict)
        """Slices of A-lines by number and fragment; of those that share a frame all in the first one's."""
        self.again: set[int] = set()
        """Numbers of A-lines that came as a retransmission."""

    def raw(self, data: bytes) -> None:
        """Send arbitrary bytes."""
        self._transport.write(data)

    def frame(self, kind: int, payload: bytes, *, flags: int = 0, session: int = -1, boot: int = -1) -> bytes:
        """Return the encoded bytes of a frame, of the present session or another one."""
        hello = self.hello
        self._sequence = (self._sequence + 1) & 0xFFFF
        return encode_frame(
            Frame(
                kind,
                flags,
                boot if boot >= 0 else (hello.boot & 0xFF if hello else 0),
                session if session >= 0 else (hello.session if hello else 0),
                self._sequence,
                payload,
            )
        )

    def send(self, kind: int, payload: bytes) -> None:
        """Send a frame of the present session."""
        self.raw(self.frame(kind, payload))

    def open_session(self, nonce: int, oldest: int = PROTOCOL, newest: int = PROTOCOL) -> HelloAck | None:
        """Send HELLO until the device answers, and return the HELLO_ACK."""
        self.nonce = nonce
        for _ in range(8):
            self.send(Type.HELLO, pack(Hello(oldest, newest, MAX_PAYLOAD, nonce)))
            if self.wait(lambda: self._acks(nonce) is not None, QUIET_PERIOD):
                return self._acks(nonce)
        return None

    def _acks(self, nonce: int) -> HelloAck | None:
        acks = (unpack(HelloAck, frame.payload) for frame in self.frames if frame.type == Type.HELLO_ACK)
        return next((ack for ack in acks if ack.nonce == nonce), None)

    def connect(self) -> HelloAck:
        """Open a session, and read the capabilities if they are not known yet."""
        ack = self.open_session(1 + secrets.randbelow(0xFFFFFFFE))
        if ack is None or ack.version != PROTOCOL:
            raise Failed(f"HELLO of version {PROTOCOL} is not answered" if ack is None else f"version {ack.version}")
        self.hello, self.status, self._number = ack, None, 0
        self.replies.clear()
        if crc32c(self.caps) != ack.caps_crc or not self.limits:
            self.read_capabilities()
        self.expect(self.wait(lambda: self.status is not None, 1.0), "STATUS within a second of HELLO_ACK")
        return ack

    def read_capabilities(self) -> None:
        """Read the device's capabilities, piece by piece."""
        assert self.hello is not None  # noqa: S101
        self.caps, tries = b"", 0
        while len(self.caps) < self.hello.caps_size:
            before, tries = len(self.caps), tries + 1
            self.send(Type.CAPS, CAPS_REQUEST.pack(before))
            self.wait(lambda before=before: len(self.caps) > before, QUIET_PERIOD)  # type: ignore[misc]
            self.expect(len(self.caps) > before or tries < 20, f"a piece of the capabilities from byte {before}")
        self.expect(crc32c(self.caps) == self.hello.caps_crc, "capabilities with HELLO_ACK's CRC")
        self.limits = unpack_body(self.caps)

    def next_request_id(self) -> int:
        """Return a new request id."""
        self._number += 1
        return self._number

    def request(self, operation: int, *, number: int = 0, patience: float = REPLY, **body: Any) -> Reply:
        """Send a request until the device replies, and return the reply."""
        number = number or self.next_request_id()
        self.replies.pop(number, None)
        for _ in range(max(1, round(2 * patience))):
            self.send(Type.REQ, REQUEST_HEAD.pack(number, operation) + (pack_body(body) if body else b""))
            if self.wait(lambda: number in self.replies, 0.5):
                return self.replies[number]
        raise Failed(f"no reply to {Operation(operation).name}")

    def request_ok(self, operation: int, **body: Any) -> dict[str, Any]:
        """Send a request that must succeed, and return the parameters of its reply."""
        reply = self.request(operation, **body)
        self.expect(reply.result == 0, f"{Operation(operation).name} granted, not result {reply.result} ({reply.body})")
        return reply.body

    def abort(self, level: int) -> AbortAck:
        """Send ABORT until it is acknowledged, and return the acknowledgement."""
        self._aborts += 1
        number = (self.nonce + self._aborts) & 0xFFFFFFFF

        def answer() -> AbortAck | None:
            acks = (unpack(AbortAck, frame.payload) for frame in self.received(Type.ABORT_ACK))
            return next((ack for ack in acks if (ack.level, ack.number) == (level, number)), None)

        for _ in range(25):
            self.send(Type.ABORT, pack(Abort(level, number)))
            if self.wait(lambda: answer() is not None, 0.1) and (ack := answer()) is not None:
                return ack
        raise Failed(f"ABORT of level {level} is not acknowledged")

    def lease(self, echo: int, ttl: int | None = None) -> None:
        """Send LEASE, which renews the laser lease."""
        assert self.hello is not None  # noqa: S101
        self.send(Type.LEASE, pack(Lease(self.hello.boot, echo, self.ttl if ttl is None else ttl)))

    def acknowledge(self, durable: int, limit: int, *missing: tuple[int, int]) -> None:
        """Send ALINE_ACK, which acknowledges A-lines, grants credit and requests missing ones."""
        tail = b"".join(MISSING.pack(*item) for item in missing)
        self.send(Type.ALINE_ACK, pack(ALineAck(self.plan, durable, limit)) + tail)

    def points(self, count: int) -> np.ndarray[tuple[int], np.dtype[np.void]]:
        """Return plan points near the centre of the film, one step apart."""
        points = np.zeros(count, POINT)
        for axis in ("x", "y"):
            low, high = self.limits[f"{axis}_nm"]
            points[axis] = (low + high) // 2 + (np.arange(count) * 1000 if axis == "x" else 0)
        points["averages"] = self.limits["averages"][0]
        return points

    def plan_new(self, count: int, **changes: Any) -> dict[str, Any]:
        """Return the parameters of PLAN_NEW for a new plan within all limits of the device."""
        self.plan = self.plan % 0xFFFFFFFE + 1
        self._uploading = np.zeros(0, POINT)
        limits = self.limits
        return {
            "plan": self.plan,
            "length": count,
            "samples": min(max(64, limits["samples"][0]), limits["samples"][1]),
            "interval_ps": min(max(8000, limits["interval_ps"][0]), limits["interval_ps"][1]),
            "pulse_rate_mhz": self.pulse_rate,
            "purge": True,
            **changes,
        }

    @property
    def pulse_rate(self) -> int:
        """Pulse rate of the test's plans, in mHz."""
        low, high = self.limits["pulse_rate_mhz"]
        return min(max(100_000, int(low)), int(high))

    def send_plan_data(self, points: np.ndarray[tuple[int], np.dtype[np.void]], first: int = 0) -> None:
        """Send points as PLAN_DATA, in frames small enough for any line."""
        assert self.hello is not None  # noqa: S101
        each = (self.hello.max_payload - PLAN_HEAD.size) // POINT.itemsize
        for at in range(0, len(points), each):
            part = points[at : at + each]
            self.send(Type.PLAN_DATA, PLAN_HEAD.pack(self.plan, first + at, len(part)) + part.tobytes())

    def upload(self, count: int, *, beams: int = 1, start: int = 0) -> None:
        """Upload a valid plan; points beyond the device's memory follow during the scan."""
        self.fragments.clear()
        self.again.clear()
        asked = {"beams": beams, "start": start} if beams > 1 else {}
        self.request_ok(Operation.PLAN_NEW, **self.plan_new(count, **asked))
        points = np.repeat(self.points(count // beams), beams)
        self._uploading, self._offered, self._offered_at = points, -1, 0
        self.expect(self.wait(lambda: self.state is DeviceState.READY, 10.0), f"READY, not {self.state.name}")

    def _go_on_uploading(self, status: PlanStatus) -> None:
        first, stop = status.expected, min(status.limit, len(self._uploading))
        if status.plan != self.plan or first >= stop:
            return
        now = self._clock.now()
        if first > self._offered or now - self._offered_at > RETRY_INTERVAL:
            self._offered, self._offered_at = first, now
            self.send_plan_data(self._uploading[first:stop], first)

    def start(self, *, renewing: bool = True) -> None:
        """Send ARM and START, with a fresh time echo."""
        token = self.request_ok(Operation.ARM)["token"]
        self.request_ok(Operation.START, token=token, echo=self.fresh(), ttl=self.ttl)
        self.renewing = renewing

    def prepare(self) -> None:
        """Open a new session and bring the device into the state in which it accepts a plan."""
        self.renewing = False
        self.forget()
        self.connect()
        if self.state in RUNNING:
            self.abort(AbortLevel.LASER_OFF)
        if self.state in (DeviceState.FAULT, DeviceState.ESTOP):
            self.request(Operation.CLEAR_FAULT)
        if self.state is DeviceState.SAFE_HOLD:
            self.request(Operation.RELEASE)
        wanted = {DeviceState.LINKED, DeviceState.READY, DeviceState.DONE, DeviceState.DRAINING, DeviceState.PAUSED}
        self.expect(
            self.state in wanted, f"a state that takes a plan after CLEAR_FAULT and RELEASE, not {self.state.name}"
        )

    @property
    def rate(self) -> float:
        """Declared rate of the device's clock, in device seconds per second."""
        return float(self.limits.get("clock_rate", 1.0))

    @property
    def ttl(self) -> int:
        """Lease duration (time to live) requested by the host, in µs of device time."""
        return min(round(500_000 * self.rate), int(self.limits["lease_cap_us"]))

    @property
    def state(self) -> DeviceState:
        """Device state in the last STATUS."""
        return DeviceState(self.status.state) if self.status else DeviceState.BOOT

    def fresh(self) -> int:
        """Wait for a new STATUS and return its device time."""
        before = self.status.device_time if self.status else 0
        self.expect(self.wait(lambda: self.now() > before, 1.0), "STATUS at 10 Hz")
        return self.now()

    def now(self) -> int:
        """Return the device time of the last STATUS."""
        return self.status.device_time if self.status else 0

    def host_time(self) -> int:
        """Return the host's time in µs."""
        return self._clock.now()

    def forget(self) -> None:
        """Clear the record of received frames."""
        self.frames.clear()

    def received(self, kind: int) -> list[Frame]:
        """Return the received frames of one type."""
        return [frame for frame in self.frames if frame.type == kind]

    def expect(self, condition: object, what: str) -> None:
        """Raise :class:`Failed` unless ``condition`` holds, with a message that names the requirement."""
        if not condition:
            raise Failed(f"expected: {what}")

    def wait(self, over: Callable[[], bool], seconds: float) -> bool:
        """Receive frames until ``over()`` is true or a timeout expires; return whether it is true."""
        deadline = self._clock.now() + int(seconds * 1e6)
        while not over() and self._clock.now() < deadline:
            self.absence = max(self.absence, (self._clock.now() - self._looked_at) * 1e-6)
            data = self._transport.read()
            self._looked_at = self._clock.now()
            for frame in self._deframer.feed(data):
                self.frames.append(frame)
                try:
                    self._take(frame)
                except (FrameError, ValueError) as error:
                    raise Failed(f"a frame of type {frame.type:02X} that cannot be read: {error}") from error
        return over()

    def listen(self, seconds: float) -> None:
        """Receive and record frames for a given time."""
        self.wait(lambda: False, seconds)

    def _take(self, frame: Frame) -> None:
        hello = self.hello
        if hello is None or (frame.session, frame.boot) != (hello.session, hello.boot & 0xFF):
            return
        if frame.type == Type.STATUS:
            self.status = unpack(Status, frame.payload)
            if self.renewing and self.status.state in RUNNING:
                self.lease(self.status.device_time)
        elif frame.type == Type.RSP:
            number, _, result, state = unpack_exact(REPLY_HEAD, frame.payload, tail=True)
            self.replies[number] = Reply(result, state, unpack_body(frame.payload[REPLY_HEAD.size :]))
            if self.status is not None:
                self.status = self.status._replace(state=state)
        elif frame.type == Type.ABORT_ACK and self.status is not None:
            self.status = self.status._replace(state=unpack(AbortAck, frame.payload).state)
        elif frame.type == Type.PLAN_STATUS:
            self.plan_status = unpack(PlanStatus, frame.payload)
            self._go_on_uploading(self.plan_status)
        elif frame.type == Type.CAPS_PIECE:
            offset, _ = unpack_exact(CAPS_HEAD, frame.payload, tail=True)
            if offset == len(self.caps):
                self.caps += frame.payload[CAPS_HEAD.size :]
        elif frame.type == Type.FAULT:
            self.send(Type.FAULT_ACK, pack(unpack(Fault, frame.payload)))
        elif frame.type == Type.ALINE:
            self._take_aline(frame)

    def _take_aline(self, frame: Frame) -> None:
        head = unpack(ALineHead, frame.payload, tail=True)
        if head.plan != self.plan:
            return
        if head.more:
            raise Failed("A-lines that share a frame, of which PLAN_NEW's group said nothing")
        self.fragments[head.number][head.fragment] = frame.payload[16:]
        if frame.flags & FLAG_RETRANSMISSION:
            self.again.add(head.number)
        self.fragments[head.number].setdefault(-1, bytes([head.fragments, head.encoding]))

    def blobs(self) -> dict[int, bytes]:
        """Return the completely received A-lines by number, each as meta ‖ encoded samples."""
        whole = {}
        for number, parts in self.fragments.items():
            count = parts[-1][0]
            if all(index in parts for index in range(count)):
                whole[number] = b"".join(parts[index] for index in range(count))
        return whole
