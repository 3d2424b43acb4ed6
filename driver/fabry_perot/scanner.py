"""The synchronous driver: a scanner as an application sees it."""

from __future__ import annotations

from collections.abc import Iterator
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from fabry_perot.aline import ALine
from fabry_perot.capabilities import Capabilities
from fabry_perot.clock import Clock
from fabry_perot.codes import AbortLevel, Operation
from fabry_perot.errors import NoAnswer, PlanInvalid, ScannerError
from fabry_perot.host import HostTiming, Plan
from fabry_perot.messages import Status
from fabry_perot.session import STEP, Session
from fabry_perot.states import RUNNING, DeviceState
from fabry_perot.streaming import stop_reason
from fabry_perot.transport import Transport, open_transport

_LIVE = RUNNING | {DeviceState.ARMED}
_LEVELS = {
    "pause": AbortLevel.PAUSE,
    "laser-off": AbortLevel.LASER_OFF,
    "emergency-stop": AbortLevel.EMERGENCY_STOP,
}


class Scanner:
    """A connected scanner; use :func:`connect` and a ``with`` block.

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
    """

    def __init__(self, transport: Transport, clock: Clock | None = None, timing: HostTiming | None = None) -> None:
        self._session = Session(transport, clock, timing)
        self._host = self._session.host
        self._points = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def capabilities(self) -> Capabilities:
        """Limits and identity."""
        capabilities = self._host.capabilities
        if capabilities is None:
            raise NoAnswer("not connected")
        return capabilities

    @property
    def state(self) -> str:
        """The device's state in lower case, for example ``"scanning"``."""
        return self._host.device_state.name.lower()

    @property
    def status(self) -> Status:
        """The device's last STATUS."""
        status = self._host.status
        if status is None:
            raise NoAnswer("not connected")
        return status

    def upload(
        self,
        points: ArrayLike,
        *,
        samples: int,
        sampling_interval: float,
        pulse_rate: float,
        averages: int = 1,
        wavelength: float = 0.0,
        resume: bool = False,
    ) -> None:
        """Upload a plan.

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
            Interrogation wavelength in m; 0 for the device's own map.
        resume
            Continue the very same plan if the device still holds it (after a crash of the host, say): A-lines never
            acknowledged come again, none is fired twice. Without it a new plan begins and the device discards what it
            held.

        Raises
        ------
        PlanInvalid
            The scanner cannot do this; or ``resume`` and it holds another plan or none.
        """
        where = np.asarray(points, dtype=np.float64)
        self.capabilities.check(
            where,
            samples=samples,
            sampling_interval=sampling_interval,
            pulse_rate=pulse_rate,
            averages=averages,
        )
        plan = Plan.from_metres(
            where,
            samples=samples,
            sampling_interval=sampling_interval,
            pulse_rate=pulse_rate,
            averages=averages,
            wavelength=wavelength,
        )
        if not resume:
            self._session.call(lambda now: self._host.upload(plan, now))
        else:
            self._session.wait(self._plan_known, 2.0)
            with self._session.changed:
                adopted = self._host.adopt(plan, self._session.now())
            if not adopted:
                raise PlanInvalid("resume", f"plan {plan.uid:08x}", "the plan the scanner holds")
            self._session.flush()
        self._points = plan.length
        self._session.wait(self._uploaded, 10.0)
        if self._host.device_state is DeviceState.SAFE_HOLD:
            self._session.request(Operation.RELEASE)

    def _plan_known(self) -> bool:
        return not self.status.plan or self._host.plan_status is not None

    def _uploaded(self) -> bool:
        uploader = self._host.uploader
        if uploader is not None and uploader.refused:
            raise PlanInvalid("points", "refused by the device", "positions and averages within its limits")
        state = self._host.device_state
        return uploader is not None and (uploader.done or state is DeviceState.READY)

    def arm(self) -> int:
        """Arm the laser and return the token that :meth:`start` needs; nothing fires yet."""
        return int(self._session.request(Operation.ARM)["token"])

    def start(self, token: int) -> None:
        """Start scanning; from now on the lease must be kept alive by consuming :meth:`alines`."""
        with self._session.changed:
            fields = self._host.lease_fields()
        self._session.request(Operation.START, token=token, **fields)

    def alines(self) -> Iterator[list[ALine]]:
        """Yield lists of A-lines in order of their number, as they arrive, until the plan is done.

        Each comes exactly once. Store a batch durably, then :meth:`acknowledge` its last A-line: the device keeps
        everything that was not acknowledged and stops firing when its ring is full.

        Raises
        ------
        LeaseLapsed
            The application took longer than the lease's time to live: the laser is off, nothing is lost;
            :meth:`resume` and iterate again.
        ScanAborted, DeviceFault, EmergencyStopped, DeviceRestarted, LinkLost
            The scan stopped.
        """
        while True:
            with self._session.changed:
                now = self._session.now()
                self._host.renew(now)
                batch = self._host.take()
                if not batch:
                    if self._finished():
                        break
                    error = stop_reason(self._host, now)
                    if error is not None:
                        raise error
                    self._session.changed.wait(STEP)
            self._session.flush()
            if batch:
                yield batch
        self._settle()

    def _finished(self) -> bool:
        assembly = self._host.assembly
        return assembly is None or assembly.delivered >= self._points

    def _settle(self) -> None:
        """Give the device a moment to confirm what was acknowledged."""
        try:
            self._session.wait(self._confirmed, 2.0)
        except ScannerError:
            return

    def _confirmed(self) -> bool:
        assembly, status = self._host.assembly, self._host.status
        return assembly is None or (status is not None and status.acknowledged >= assembly.durable)

    def acknowledge(self, aline: ALine) -> None:
        """Declare ``aline`` and all before it durably stored; the device frees them, and the lease is renewed."""
        with self._session.changed:
            self._host.acknowledge(aline.number, self._session.now())
        self._session.flush()

    def pause(self) -> None:
        """Stop firing; :meth:`resume` continues with the next point. :meth:`alines` goes on waiting."""
        self._session.request(Operation.PAUSE)

    def resume(self) -> None:
        """Arm anew and continue after a pause, a lapsed lease or an abort."""
        if self._host.device_state is DeviceState.SAFE_HOLD:
            self._session.request(Operation.RELEASE)
        self.start(self.arm())

    def disarm(self) -> None:
        """Withdraw the arm token, or end a scan with its plan and data kept."""
        self._session.request(Operation.DISARM)

    def park(self) -> None:
        """Close the shutter and go to the rest position; not while scanning."""
        self._session.request(Operation.PARK)

    def clear_fault(self) -> None:
        """Clear a latched fault or emergency stop; the laser stays off."""
        self._session.request(Operation.CLEAR_FAULT)

    def abort(self, level: str = "laser-off") -> None:
        """Stop at once: ``"pause"``, ``"laser-off"`` or ``"emergency-stop"`` (latched). Works in every state."""
        if level not in _LEVELS:
            raise PlanInvalid("level", level, " | ".join(_LEVELS))
        with self._session.changed:
            self._host.abort(_LEVELS[level], self._session.now())
        self._session.flush()
        self._session.wait(lambda: not self._host.aborting, 5.0)

    def statistics(self) -> dict[str, Any]:
        """Return counters of both sides: device values as in STATUS, host values prefixed ``host_``."""
        answer = self._session.request(Operation.GET)
        counters, assembly = self._host.deframer.counters, self._host.assembly
        answer |= {
            "host_good_frames": counters.good,
            "host_bad_frames": counters.bad,
            "host_foreign_frames": self._host.foreign_frames,
            "host_bytes": counters.bytes_in,
            "host_gone": self._host.gone,
        }
        if assembly is not None:
            answer |= {
                "host_repairs": assembly.repairs,
                "host_duplicates": assembly.duplicates,
                "host_damaged": assembly.damaged,
            }
        return answer

    def close(self) -> None:
        """Switch the laser off if it is on, and release the port."""
        try:
            if self._host.failure is None and self._host.device_state in _LIVE:
                self.abort("laser-off")
        except (ScannerError, OSError):
            return
        finally:
            self._session.close()


def connect(url: str, *, baudrate: int = 3_000_000, timing: HostTiming | None = None) -> Scanner:
    """Open a port, begin a session and read the capabilities.

    Parameters
    ----------
    url
        A device path or pyserial URL, for example ``/dev/ttyUSB0`` or ``socket://127.0.0.1:4001``.
    baudrate
        Baud rate of a UART.
    timing
        Time limits of the host's side.

    Raises
    ------
    PortBusy, PortUnavailable, NoAnswer, ProtocolMismatch
        There is no scanner to talk to.
    """
    return Scanner(open_transport(url, baudrate), timing=timing)
