"""State of the host: session, plan, A-lines and timers."""

from __future__ import annotations

from typing import Any

from fabry_perot.errors import DeviceRestarted, LinkError, LinkLost, ScannerError
from fabry_perot.host.aborts import Aborts
from fabry_perot.host.aline import ALineBatch
from fabry_perot.host.capabilities import Capabilities
from fabry_perot.host.handshake import Handshake
from fabry_perot.host.link_states import HostState
from fabry_perot.host.plan import WirePlan
from fabry_perot.host.reassembly import AlineReassembler
from fabry_perot.host.requests import PendingRequest, RequestTracker
from fabry_perot.host.timing import HostTiming
from fabry_perot.host.traffic import Traffic
from fabry_perot.host.uploader import Uploader
from fabry_perot.wire.constants import AbortLevel, Operation, Type
from fabry_perot.wire.framing import FLAG_RETRANSMISSION, FLAG_URGENT, MAX_PAYLOAD, Deframer, Frame, encode_frame
from fabry_perot.wire.messages import (
    CAPS_REQUEST,
    MISSING,
    AbortAck,
    ALineAck,
    Hello,
    HelloAck,
    Lease,
    PlanStatus,
    Status,
    pack,
)
from fabry_perot.wire.states import RUNNING, DeviceState


class HostBody:
    """State of a host: session, plan, A-lines, time limits; the base of :class:`~fabry_perot.host.host.Host`.

    Parameters
    ----------
    nonce
        Any u32; a new one asks for a new session.
    timing
        Time limits.
    max_payload
        Largest payload this side takes, in bytes.
    """

    def __init__(self, nonce: int, timing: HostTiming | None = None, max_payload: int = MAX_PAYLOAD) -> None:
        self.timing = timing or HostTiming()
        self.nonce, self.max_payload = nonce, max_payload
        self.deframer = Deframer()
        self.traffic = Traffic(self.deframer.counters)
        self.greeting = Handshake(self.timing, self.traffic)
        self.calls = RequestTracker(self.timing, self.traffic)
        self.hello: HelloAck | None = None
        self.status: Status | None = None
        self.plan_status: PlanStatus | None = None
        self.capabilities: Capabilities | None = None
        self.device_state = DeviceState.BOOT
        self.fault = 0
        """Code of the last fault that the device reported."""
        self.failure: ScannerError | None = None
        self.assembly: AlineReassembler | None = None
        self.uploader: Uploader | None = None
        self.caps_buffer = b""
        self.gone = 0
        self.tolerant = False
        """Whether :class:`~fabry_perot.host.auto_recovery.ScanRecovery` deals with a reboot of the device."""
        self.last_words: Status | None = None
        """Last STATUS of a boot that ended."""
        self.foreign_frames = 0
        self.clock_rate = 1.0
        self.heard_at = 0
        self.phase = HostState.CLOSED
        self.ack_due = False
        self._out: list[bytes] = []
        self._sequence = 0
        self._polled_at = self._caps_due = self._acked_at = self._leased_at = 0
        self._echo_sent = -1
        self.contact = (0, 0)
        """Host time and device time of the last proof that application and running device heard of each other."""
        self.aborts = Aborts(nonce, self.timing.abort_period)

    @property
    def state(self) -> HostState:
        """Link state of the host, including silence and gaps."""
        if self.phase is HostState.STREAMING and self.assembly is not None:
            if self.assembly.has_gaps:
                return HostState.GAP_FILL
            if self.device_state in (DeviceState.DRAINING, DeviceState.DONE):
                return HostState.DRAINING
        return self.phase

    @property
    def session(self) -> int:
        """Session number, 0 before the first session."""
        return self.hello.session if self.hello else 0

    @property
    def payload(self) -> int:
        """Largest payload in bytes agreed for this line."""
        return self.hello.max_payload if self.hello else 64

    def time_since_heard(self, now: int) -> int:
        """Return the µs since the last message of the device."""
        return now - self.heard_at

    def open(self, now: int) -> None:
        """Start the handshake for a session."""
        self.phase, self.heard_at = HostState.HELLO, now
        self.greeting.begin(now)
        self.tick(now)

    def link_lost(self) -> None:
        """Handle the loss of the port; :meth:`reopen` follows when the port is available again."""
        self.phase = HostState.LOST
        self._out.clear()

    def reopen(self, nonce: int, now: int) -> None:
        """Request a new session on a reopened port; received A-lines are retained."""
        self.nonce, self.deframer = nonce, Deframer(counters=self.deframer.counters)
        self.open(now)

    def session_renewed(self, ack: HelloAck) -> None:
        """Continue in a new session, of the same boot of the device or of another one."""
        same = self.hello is not None and self.hello.boot == ack.boot
        self.calls.fail(LinkLost("the session was renewed meanwhile") if same else DeviceRestarted())
        self._echo_sent, self.ack_due = -1, True
        if not same:
            self.last_words, self.status, self.plan_status = self.status, None, None
            self.aborts.drop()

    def tick(self, now: int) -> None:
        """Send messages due at host time ``now``."""
        self._polled_at = now
        if self.phase is not HostState.LOST and (abort := self.aborts.due(now)) is not None:
            self.send(Type.ABORT, abort, FLAG_URGENT)  # also of a session that has failed
        if self.phase in (HostState.CLOSED, HostState.LOST):
            return
        if self.phase is HostState.HELLO or self.time_since_heard(now) > self.timing.silence:
            self._say_hello(now)
        if self.phase is HostState.CONFIG and now >= self._caps_due:
            self._caps_due = now + self.timing.hello_period
            self.send(Type.CAPS, CAPS_REQUEST.pack(len(self.caps_buffer)))
        if self.hello is None:
            return
        for payload, again in self.calls.due_payloads(now):
            self.send(Type.REQ, payload, FLAG_RETRANSMISSION if again else 0)
        if self.uploader is not None:
            for payload in self.uploader.due(now):
                self.send(Type.PLAN_DATA, payload)
        self._acknowledge(now)

    def _say_hello(self, now: int) -> None:
        try:
            due = self.greeting.due(now, counted=self.phase is HostState.HELLO and not self.tolerant)
        except LinkError as error:
            self.fail(error)
            return
        if due:
            self.send(Type.HELLO, pack(Hello(*self.greeting.versions, self.max_payload, self.nonce)))

    def other_version(self, version: int) -> None:
        """Handle a device that answers HELLO with another protocol version, or with none (0)."""
        self.nonce ^= 1
        if (error := self.greeting.mismatch(version)) is not None:
            self.fail(error)

    def _acknowledge(self, now: int) -> None:
        assembly = self.assembly
        if assembly is None:
            return
        gaps = assembly.has_gaps
        if not (gaps or self.ack_due) and now - self._acked_at < self.timing.ack_period:
            return
        missing = assembly.missing(now) if gaps else []
        confirmed = self.status is not None and self.status.acknowledged >= assembly.durable
        busy = self.device_state in RUNNING or self.device_state is DeviceState.DRAINING
        again = now - self._acked_at >= self.timing.ack_period and (busy or not confirmed)
        if self.ack_due or missing or again:
            self.ack_due, self._acked_at = False, now
            tail = b"".join(MISSING.pack(*item) for item in missing)
            ack = ALineAck(assembly.plan, assembly.durable, assembly.limit)
            self.send(Type.ALINE_ACK, pack(ack) + tail)

    def request_capabilities(self, now: int) -> None:
        """Request the next piece of the device's capabilities."""
        self._caps_due = now

    def send(self, kind: Type, payload: bytes, flags: int = 0) -> None:
        """Queue one frame for sending."""
        boot = self.hello.boot & 0xFF if self.hello else 0
        self._sequence = (self._sequence + 1) & 0xFFFF
        self._out.append(encode_frame(Frame(kind, flags, boot, self.session, self._sequence, payload)))

    def take_output(self) -> bytes:
        """Return the bytes to send now."""
        if not self._out:
            return b""
        data = b"".join(self._out)
        self._out.clear()
        return data

    def fail(self, error: ScannerError) -> None:
        """End all pending operations with ``error``."""
        self.failure = self.failure or error
        self.phase = HostState.CLOSED
        self.calls.fail(error)

    def call(self, operation: Operation, now: int, **body: Any) -> PendingRequest:
        """Start a request and return its handle (pending request)."""
        call = self.calls.start(operation, body, now)
        if self.failure is not None:
            self.calls.fail(self.failure)
        self.tick(now)
        return call

    def upload(self, plan: WirePlan, now: int, start: int = 0) -> PendingRequest:
        """Replace the device's plan with ``plan`` from point ``start``; A-lines of another plan are discarded."""
        self.uploader = Uploader(plan, self.payload, self.timing.upload_period, start)
        self.assembly = None
        self.phase = HostState.UPLOAD
        return self.call(Operation.PLAN_NEW, now, **plan.request(purge=True, start=start))

    def upload_again(self, plan: WirePlan, now: int) -> PendingRequest:
        """Upload to a rebooted device the points without a received A-line."""
        start = self.assembly.complete if self.assembly else 0
        self.uploader = Uploader(plan, self.payload, self.timing.upload_period, start)
        return self.call(Operation.PLAN_NEW, now, **plan.request(purge=False, start=start))

    def resume_plan(self, plan: WirePlan, now: int, start: int = 0) -> bool:
        """Continue ``plan`` if the device has it, from its last acknowledged A-line or from ``start``."""
        status = self.status
        if status is None or status.plan != plan.uid or self.plan_status is None:
            return False
        # The laser is off since before this session, so the position is where the next START begins.
        self.uploader = Uploader(plan, self.payload, self.timing.upload_period, status.position)
        self.uploader.receive(self.plan_status, now)
        self.receive_from(plan.uid, max(start, status.acknowledged))
        self.tick(now)
        return True

    def receive_from(self, plan: int, start: int) -> None:
        """Start receiving A-lines of ``plan`` from number ``start``, and grant the device credit."""
        window = self.hello.ring if self.hello else 1
        self.assembly = AlineReassembler(plan, start, window, 2 * self.timing.ack_period)
        self.phase = HostState.UPLOAD
        self.ack_due = True

    def lease_fields(self) -> dict[str, int]:
        """Return time echo and TTL (µs of device time) for a lease renewal sent now."""
        echo = self.status.device_time if self.status else 0
        return {"echo": echo, "ttl": min(round(self.timing.ttl * self.clock_rate), 0xFFFFFFFF)}

    def renew(self, now: int) -> None:
        """Renew the laser lease, because the consumer is active; without a fresh time echo, nothing is sent."""
        if self.status is None or self.hello is None or self.device_state not in RUNNING or self.aborting:
            return
        if self.status.device_time <= self._echo_sent or now - self._leased_at < self.timing.lease_period:
            return
        self._echo_sent, self._leased_at = self.status.device_time, now
        self.contact = (now, self.status.device_time)
        self.send(Type.LEASE, pack(Lease(self.hello.boot, **self.lease_fields())))

    def seconds_since_contact(self, now: int) -> float:
        """Return the seconds since :attr:`contact`, by the clock that counts more of them.

        A host's clock may leave out the time its computer slept, and a STATUS may have waited in a buffer.
        """
        host, device = self.contact
        passed = self.status.device_time - device if self.status else 0
        return max(now - host, passed / self.clock_rate) * 1e-6

    def take(self) -> ALineBatch:
        """Return the next A-lines in order."""
        return self.assembly.pop_ready() if self.assembly else ALineBatch()

    def acknowledge(self, number: int, now: int) -> None:
        """Report to the device that A-line ``number`` and all before it are durably stored; renews the lease."""
        if self.assembly is not None:
            self.assembly.acknowledge(number + 1)
            self.ack_due = True
        self.renew(now)
        self.tick(now)

    def abort(self, level: AbortLevel, now: int) -> None:
        """Send ABORT until it is acknowledged, at least with the level of a pending ABORT."""
        self.aborts.start(level, now)
        self.tick(now)

    def abort_acknowledged(self, ack: AbortAck) -> None:
        """Stop repeating the ABORT that ``ack`` answers."""
        if self.aborts.acknowledge(ack):
            self.device_state = DeviceState(ack.state)

    @property
    def aborting(self) -> bool:
        """Whether an ABORT is not acknowledged yet."""
        return self.aborts.pending
