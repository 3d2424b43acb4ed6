"""Synchronous driver of a scanner for applications."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from fabry_perot.clock import Clock
from fabry_perot.errors import (
    DeviceFault,
    DeviceRestarted,
    LeaseExpired,
    LinkError,
    LinkLost,
    PlanInvalid,
    ResponseTimeout,
    ScanAborted,
    ScannerError,
)
from fabry_perot.host import HostTiming, RecoveryPolicy, ScanRecovery, ScanReport, WirePlan
from fabry_perot.host.aline import ALine, ALineBatch
from fabry_perot.host.io_pump import stream_end_reason
from fabry_perot.host.scanner_controls import ScannerControls
from fabry_perot.host.session import POLL_STEP, Session
from fabry_perot.host.transport import Transport
from fabry_perot.wire.constants import Operation
from fabry_perot.wire.states import RUNNING, DeviceState, HoldCause

_LIVE = RUNNING | {DeviceState.ARMED}
_PATIENCE = 15.0
"""Seconds within which a scan is taken up, or not."""


class Scanner(ScannerControls):
    """Connected scanner; use :func:`connect` and a ``with`` block.

    The I/O runs in one background thread. The laser stays on only while the application consumes A-lines: waiting
    inside :meth:`alines` and calling :meth:`acknowledge` renew its lease, nothing else does.

    Parameters
    ----------
    transport
        The open port.
    clock
        Host time.
    timing
        Time limits.
    recovery
        How long a scan is carried over interruptions; ``None``: not at all.
    reopen
        Opens the port again after it was lost.
    port
        The port, for the control socket by which other programs can stop the laser; ``None``: no such socket.
    cancelled
        Asked until a session has come about: once it says so, ResponseTimeout is raised.
    """

    def __init__(
        self,
        transport: Transport,
        clock: Clock | None = None,
        timing: HostTiming | None = None,
        recovery: RecoveryPolicy | None = None,
        reopen: Callable[[], Transport] | None = None,
        port: str | None = None,
        cancelled: Callable[[], bool] | None = None,
    ) -> None:
        policy = recovery or RecoveryPolicy(patience=0.0, restarts=False)
        super().__init__(Session(transport, clock, timing, reopen, policy.patience, port, cancelled), policy)
        self._policy = recovery
        self._plan: WirePlan | None = None
        self._acknowledged = self._first = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def upload(
        self,
        points: ArrayLike,
        *,
        samples: int,
        sampling_interval: float,
        pulse_rate: float,
        averages: int = 1,
        wavelength: ArrayLike = 0.0,
        gated: ArrayLike = False,
        encoding: str = "auto",
        resume: bool = False,
        start: int = 0,
        tag: int = 0,
        beams: int = 1,
    ) -> None:
        """Validate a scan plan and upload it to the device.

        Parameters
        ----------
        points
            (M, 2) positions on the film, in m, in the order of visiting.
        samples
            Samples per A-line.
        sampling_interval
            Seconds between samples.
        pulse_rate
            Laser pulses per second.
        averages
            Shots per point.
        wavelength
            Interrogation wavelength in m, one or one per point (:class:`fabry_perot.TuningMap` has them); 0 for the
            device's own map.
        gated
            Whether a point waits for the next edge at the scanner's gate input, one answer or one per point.
        encoding
            How A-lines travel: ``"int16"``, ``"delta-rice"`` (packed, lossless), or ``"auto"``.
        resume
            Continue the very same plan if the device still holds it (after a crash of the host, say): A-lines never
            acknowledged come again, none is fired twice. Without it a new plan begins and the device discards what it
            held.
        start
            First point to measure; A-lines of those before it are stored already, and A-lines keep their numbers. For
            a scan whose scanner and host both went down.
        tag
            Any u32: uploads of the same points with another tag are other plans, for ``resume`` too.
        beams
            How many of the scanner's beams record each shot. ``points`` is where the first one goes, the others are at
            ``capabilities.beam_offsets`` beside it; the A-lines of points[p] are those of *point* p·beams … p·beams +
            beams − 1, a beam each, and ``start`` counts A-lines.

        Raises
        ------
        PlanInvalid
            The scanner cannot do this; or ``resume`` and it holds another plan or none.
        DeviceFault, EmergencyStopped
            A fault or an emergency stop is latched; :meth:`clear_fault` first.
        """
        self._must_not_be_latched()
        where = np.asarray(points, dtype=np.float64)
        self.capabilities.check(
            where,
            samples=samples,
            sampling_interval=sampling_interval,
            pulse_rate=pulse_rate,
            averages=averages,
            encoding=encoding,
        )
        self.capabilities.check_beams(beams)
        plan = WirePlan.from_metres(
            where,
            samples=samples,
            sampling_interval=sampling_interval,
            pulse_rate=pulse_rate,
            averages=averages,
            wavelength=self.capabilities.wavelengths(wavelength, len(where)),
            gated=self.capabilities.gated(gated, len(where)),
            encoding=self.capabilities.encoding(encoding),
            tag=tag,
            beams=beams,
        )
        if not 0 <= start < plan.length:
            raise PlanInvalid("start", start, f"0 … {plan.length - 1}")
        self._keep_nothing()
        if not resume:
            self._session.call(lambda now: self._host.upload(plan, now, start))
        else:
            self._session.wait(self._plan_known, 2.0)
            with self._session.changed:
                adopted = self._host.resume_plan(plan, self._session.now(), start)
            if not adopted:
                raise PlanInvalid("resume", f"plan {plan.uid:08x}", "the plan the scanner holds")
            self._session.flush()
        self._begin(plan)
        self._session.wait(self._uploaded, 5.0, progress=self._upload_stands)
        if self._host.device_state is DeviceState.SAFE_HOLD:
            self._session.request(Operation.RELEASE)

    def _begin(self, plan: WirePlan) -> None:
        """Start the shot accounting of a scan."""
        assembly = self._host.assembly
        self._plan, self._acknowledged = plan, assembly.delivered if assembly else 0
        self._first = self._acknowledged
        self._keeper = ScanRecovery(self._host, self._policy or RecoveryPolicy(patience=0.0, restarts=False))

    def _plan_known(self) -> bool:
        return not self.status.plan or self._host.plan_status is not None

    def _upload_stands(self) -> int:
        return self._host.plan_status.expected if self._host.plan_status is not None else 0

    def _uploaded(self) -> bool:
        uploader = self._host.uploader
        if uploader is not None and uploader.refused:
            raise PlanInvalid("points", "refused by the device", "positions and averages within its limits")
        state = self._host.device_state
        return uploader is not None and (uploader.done or state is DeviceState.READY)

    def arm(self) -> int:
        """Arm the laser and return the token for :meth:`start`; no shot is fired yet.

        Raises
        ------
        ScanAborted
            Another program sent an emergency stop; :meth:`resume` or :meth:`clear_fault` first.
        DeviceFault, EmergencyStopped
            A fault or an emergency stop is latched; :meth:`clear_fault` first.
        """
        self._must_not_be_latched()
        return int(self._session.request(Operation.ARM)["token"])

    def start(self, token: int) -> None:
        """Start scanning; afterwards, only consumption of :meth:`alines` renews the laser lease."""
        with self._session.changed:
            fields = self._host.lease_fields()
        answer = self._session.request(Operation.START, token=token, **fields)
        with self._session.changed:
            if self._plan is not None:
                self._keeper.start(self._plan, int(answer.get("laser_shots", 0)), self._session.now())

    @property
    def is_recovering(self) -> bool:
        """Whether the scan is interrupted by a failure of line or device and is being recovered."""
        with self._session.changed:
            return self._keeper.engaged and self._keeper.is_recovering

    @property
    def seconds_since_heard(self) -> float:
        """Seconds since the last message of the scanner; a working scanner sends many messages per second."""
        with self._session.changed:
            return self._host.time_since_heard(self._session.now()) / 1e6

    @property
    def has_pending_data(self) -> bool:
        """Whether :meth:`alines` may deliver more A-lines of shots that were already fired."""
        with self._session.changed:
            host, status, assembly = self._host, self._host.status, self._host.assembly
            if assembly is None or host.failure is not None:
                return False
            settled = status is not None and status.state == host.device_state and status.state not in RUNNING
            if status is None or not settled or assembly.complete > assembly.delivered:
                return True
            return status.plan == assembly.plan and assembly.delivered < status.produced

    def alines(self, *, idle: bool = False) -> Iterator[ALineBatch]:
        """Yield batches of A-lines in order of number, as they arrive, until the plan is complete.

        With ``idle`` an empty batch comes every now and then while there are none, so that the application can look
        after other things.

        Each comes exactly once. Store a batch durably, then :meth:`acknowledge` its last A-line: the device keeps
        everything that was not acknowledged and stops firing when its ring is full. A short interruption, of the line
        or of the application itself, is recovered from within the limits of :class:`fabry_perot.RecoveryPolicy`.

        Raises
        ------
        LeaseExpired
            An interruption took too long for the laser to come back by itself; nothing is lost. :meth:`resume` and
            iterate again, when a person says so.
        DeviceRestarted
            The device was without power: likewise, and what it had not delivered is fired again.
        ScanAborted, DeviceFault, EmergencyStopped, LinkLost
            The scan stopped.
        """
        while True:
            try:
                with self._session.changed:
                    batch = self._next_batch()
                    if batch is None:
                        break
                    if not batch:
                        self._session.changed.wait(POLL_STEP)
            except DeviceFault as fault:
                raise self._in_its_words(fault) from None
            self._session.flush()
            if batch or idle:
                yield batch
        self._keep_nothing()
        self._settle()

    def _next_batch(self) -> ALineBatch | None:
        """Return received A-lines, ``None`` when the plan is complete; raises the reason for a premature end."""
        now, host = self._session.now(), self._host
        host.renew(now)
        if self._session.stopped_by:
            self._keeper.release()
        if self._policy is not None:
            self._keeper.poll(now)
        batch = host.take()
        if batch:
            return batch
        if self._finished():
            return None
        kept = self._policy is not None and self._keeper.engaged
        patience = int(self._policy.patience * 1e6) if kept and self._policy else host.timing.patience
        error = stream_end_reason(host, now, patience, self._session.port or "PORT")
        if error is None or self._keeper.busy or (kept and self._keeper.is_recovering):
            return ALineBatch()
        cleared = host.status is not None and host.status.cause == HoldCause.NONE
        if kept and cleared and self._keeper.waiting and isinstance(error, ScanAborted):
            # RELEASE has cleared the cause, and then the time was over within which the keeper may go on
            error = LeaseExpired("the laser lease lapsed: the laser is off, plan and data are kept")
        if isinstance(error, LeaseExpired | ScanAborted):
            if host.status is not None and host.status.cause == HoldCause.REQUEST and not host.aborts.was_sent:
                self._session.wait_for_stop_request()
            self._session.must_not_be_stopped()
        if self._session.stopped_by and isinstance(error, LinkError):
            error = LinkLost(f"stopped by an emergency stop from {self._session.stopped_by}; then {error}")
        if isinstance(error, LeaseExpired | DeviceRestarted):
            self._keeper.disable()
        else:
            self._keeper.release()
        raise error

    def _finished(self) -> bool:
        assembly = self._host.assembly
        return assembly is None or self._plan is None or assembly.delivered >= self._plan.length

    def _settle(self) -> None:
        """Wait briefly for the device to confirm acknowledgements."""
        try:
            self._session.wait(self._confirmed, 2.0)
        except ScannerError:
            return

    def _confirmed(self) -> bool:
        assembly, status = self._host.assembly, self._host.status
        return assembly is None or (status is not None and status.acknowledged >= assembly.durable)

    def acknowledge(self, aline: ALine) -> None:
        """Declare ``aline`` and all before it durably stored: the device frees them, and the lease is renewed."""
        with self._session.changed:
            self._acknowledged = max(self._acknowledged, aline.number + 1)
            self._host.acknowledge(aline.number, self._session.now())
        self._session.flush()

    def resume(self, *, by_itself: bool = False, unless: Callable[[], bool] = lambda: False) -> None:
        """Arm the laser and continue after a pause, interruption, abort or reboot, at a person's decision.

        What a restarted device has lost is planned and fired again; :meth:`report` names it.

        Parameters
        ----------
        by_itself
            Nobody has decided so, but the application that had paused for a moment: only within the limits of
            :class:`fabry_perot.RecoveryPolicy`, on a device that kept power and whose interlock stayed closed.
        unless
            Asked once earlier stops do not count any more: ``True`` says that the scan has been stopped meanwhile.

        Raises
        ------
        LeaseExpired
            By itself it may not; the laser is off.
        PlanInvalid
            There is no scan.
        DeviceFault, EmergencyStopped
            A fault or an emergency stop is latched; :meth:`clear_fault` first.
        ScanAborted
            Another program sent an emergency stop meanwhile.
        Refused, LinkError
            It came to nothing; the laser is off.
        """
        if self._plan is None or self._host.assembly is None:
            raise PlanInvalid("resume", "no scan", "a scan that was uploaded")
        self._must_not_be_latched()
        deadline = self._session.now() + int(_PATIENCE * 1e6)
        with self._session.changed:
            if by_itself:
                self._session.must_not_be_stopped()
            self._session.stopped_by = ""
        if unless():
            raise ScanAborted("the scan was stopped before it was resumed; plan and data are kept")
        with self._session.changed:
            self._keeper.resume(self._plan, self._session.now(), by_itself=by_itself)
        while True:
            with self._session.changed:
                if self._session.stopped_by:
                    self._keeper.release()
                self._session.must_not_be_stopped()
                self._keeper.poll(self._session.now())
                error = self._keeper.refusal or self._host.failure
                if error is None and self._session.now() > deadline:
                    error = ResponseTimeout(f"the scan could not be taken up within {_PATIENCE:g} s")
                if error is not None:
                    self._keeper.disable()
                    raise error
                busy = self._keeper.busy
            self._session.flush()
            if not busy:
                return
            with self._session.changed:
                self._session.changed.wait(POLL_STEP)

    def report(self) -> ScanReport:
        """Return the shot accounting of the present scan, with the device's present counters.

        When the link is lost, or the scanner restarted when nobody kept a scan, they are those last heard, and ``age``
        says how old they are; what arrived counts anyway.
        """
        plan, host, ledger = self._plan, self._host, self._keeper.ledger
        if plan is None or host.assembly is None:
            raise PlanInvalid("report", "no scan", "a scan that was uploaded and started")
        device, age = self._counters()
        first = ledger.first if ledger.first is not None else device["laser_shots"]
        averages, wasted = int(plan.points["averages"].max()), ledger.wasted(device["shots_wasted"])
        stored, held = self._acknowledged - self._first, max(0, device["produced"] - self._acknowledged)
        fired = device["laser_shots"] - first
        places = plan.places(self._first, self._first + stored + held) + ledger.refired_places
        if age:
            fired = max(fired, averages * places + wasted)
        return ScanReport(
            points=plan.length,
            fired=fired,
            stored=stored,
            held=held,
            refired=tuple(ledger.refired),
            averages=averages,
            wasted=wasted,
            resumes=self._keeper.resumes,
            restarts=self._keeper.restarts,
            reconnects=self._session.reconnects,
            repaired=host.assembly.repairs,
            bad_frames=host.deframer.counters.bad,
            age=age,
            places=places,
        )

    def _counters(self) -> tuple[dict[str, Any], float]:
        """Return the device's counters, newly requested or the last known ones, and their age in s."""
        try:
            return self._session.request(Operation.GET), 0.0
        except (LinkError, DeviceRestarted):
            with self._session.changed:
                status, age = self.status, self._host.time_since_heard(self._session.now())
                return status._asdict() | {"laser_shots": self._keeper.ledger.laser_shots(status)}, age * 1e-6

    def close(self) -> None:
        """Switch the laser off if it is on, and release the port."""
        try:
            if self._host.failure is None and self._host.device_state in _LIVE:
                self.abort("laser-off")
        except (ScannerError, OSError):
            return
        finally:
            self._session.close()
