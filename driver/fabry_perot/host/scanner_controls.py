"""Control operations of a connected scanner."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fabry_perot import fault_codes
from fabry_perot.errors import (
    DeviceFault,
    EmergencyStopped,
    FaultStands,
    PlanInvalid,
    RequestRejected,
    ResponseTimeout,
    ScannerError,
)
from fabry_perot.host import RecoveryPolicy, ScanRecovery
from fabry_perot.host.capabilities import Capabilities
from fabry_perot.host.session import Session
from fabry_perot.host.stop_and_status_results import FaultCleared, StopAnswer, standing
from fabry_perot.host.tuning import TuningCurve, TuningMap
from fabry_perot.wire.constants import AbortLevel, Operation
from fabry_perot.wire.messages import Status
from fabry_perot.wire.states import LATCHED_STATES, DeviceState

_LEVELS = {
    "pause": AbortLevel.PAUSE,
    "laser-off": AbortLevel.LASER_OFF,
    "emergency-stop": AbortLevel.EMERGENCY_STOP,
}


class ScannerControls:
    """Base class of :class:`fabry_perot.Scanner`: state, parameters, tuning and stops.

    Parameters
    ----------
    session
        The live session.
    recovery
        How long a scan is carried over interruptions.
    """

    def __init__(self, session: Session, recovery: RecoveryPolicy) -> None:
        self._session, self._host = session, session.host
        self._keeper = ScanRecovery(session.host, recovery)

    def __repr__(self) -> str:
        known = self._host.capabilities
        if known is None:
            return f"<{type(self).__name__}: not connected>"
        kind = " (simulated)" if known.simulated else ""
        return f"<{type(self).__name__}: {known.model} {known.serial}{kind}, {self.state}>"

    @property
    def capabilities(self) -> Capabilities:
        """Limits and identity of the scanner."""
        capabilities = self._host.capabilities
        if capabilities is None:
            raise ResponseTimeout("not connected")
        return capabilities

    @property
    def state(self) -> str:
        """The device's state in lower case, for example ``"scanning"``."""
        return self._host.device_state.name.lower()

    @property
    def status(self) -> Status:
        """The device's last STATUS; directly after a reboot, still the last one before it."""
        status = self._host.status or self._host.last_words
        if status is None:
            raise ResponseTimeout("not connected")
        return status

    def pause(self) -> None:
        """Pause the scan; ``resume()`` continues with the next point, and ``alines()`` waits meanwhile."""
        self._keep_nothing()
        self._session.request(Operation.PAUSE)

    def disarm(self) -> None:
        """Invalidate the arm token, or end a scan without discarding its plan and data."""
        self._keep_nothing()
        self._session.request(Operation.DISARM)

    def park(self) -> None:
        """Close the shutter and move the beam to the rest position; not while scanning."""
        self._must_not_be_latched()
        self._session.request(Operation.PARK)

    def clear_fault(self, by: str = "") -> FaultCleared:
        """Clear a latched fault or emergency stop in a person's name; the laser stays off.

        It also ends an emergency stop that another program sent, after which this scanner cannot be armed.

        Parameters
        ----------
        by
            Name of the person.

        Raises
        ------
        FaultStands
            The cause still stands: interlock open, key off, shutter open or light.
        RequestRejected
            Nothing is latched.
        """
        status = self._next_status()
        if self._session.stopped_by and status.state not in LATCHED_STATES:
            self._session.stopped_by = ""
            return FaultCleared(fault_codes.EMERGENCY_STOP, by, datetime.now(UTC), self.state)
        if status.state not in LATCHED_STATES:
            raise RequestRejected(Operation.CLEAR_FAULT.name, "nothing is latched", DeviceState(status.state).name)
        fault = status.fault if status.state == DeviceState.FAULT else 0
        if cause := standing(status):
            raise FaultStands(fault, cause)
        self._session.request(Operation.CLEAR_FAULT)
        status = self._next_status()
        if status.state in LATCHED_STATES:
            raise FaultStands(status.fault, standing(status) or "the device reported it again at once")
        self._session.stopped_by = ""
        return FaultCleared(fault_codes.by_code(fault), by, datetime.now(UTC), self.state)

    def _next_status(self) -> Status:
        """Wait for a new STATUS and return it."""
        with self._session.changed:
            last = self._host.status
        self._session.wait(lambda: self._host.status not in (None, last), 2.0)
        return self.status

    def _in_its_words(self, fault: DeviceFault) -> DeviceFault:
        """Return a fault with the device's own description, if the device sends one in time."""
        try:
            text = str(self._session.request(Operation.GET, within=1.0).get("fault_text", ""))
        except ScannerError:
            return fault
        return DeviceFault(fault.fault, fault.port, text)

    def _must_not_be_latched(self) -> None:
        """Raise the error of a latched fault or emergency stop, with which the laser cannot be armed."""
        port = self._session.port or "PORT"
        if self._host.device_state is DeviceState.FAULT:
            raise DeviceFault(self._host.fault, port)
        if self._host.device_state is DeviceState.ESTOP:
            raise EmergencyStopped(fault_codes.advice(0, port))

    def abort(self, level: str = "laser-off") -> None:
        """Abort at once: ``"pause"``, ``"laser-off"`` or ``"emergency-stop"`` (latched); works in every state."""
        if level not in _LEVELS:
            raise PlanInvalid("level", level, " | ".join(_LEVELS))
        self._keep_nothing()
        with self._session.changed:
            self._host.abort(_LEVELS[level], self._session.now())
        self._session.flush()
        self._session.wait(lambda: not self._host.aborting, 5.0)

    def stop_laser(self, who: str = "", timeout: float = 1.5) -> StopAnswer:
        """Turn the laser off, end this session's operations, and return the device's state afterwards.

        Parameters
        ----------
        who
            Name of the person, for the ScanAborted that the application gets.
        timeout
            Longest time this takes, in s; a device that does not answer by then leaves the stop unconfirmed.
        """
        self._keep_nothing()
        return self._session.stop(who, timeout)

    def _keep_nothing(self) -> None:
        with self._session.changed:
            self._keeper.release()

    def set(self, **parameters: int) -> dict[str, int]:
        """Set parameters of the device (see ``capabilities.parameters``) and return the values of all.

        Raises
        ------
        PlanInvalid
            There is no such parameter, or the value lies outside its range.
        """
        self._must_not_be_latched()
        allowed = self.capabilities.parameters
        for name, value in parameters.items():
            if name not in allowed:
                raise PlanInvalid(name, value, " | ".join(allowed) or "nothing: this scanner has no parameters")
            low, high = allowed[name]
            if not low <= value <= high:
                raise PlanInvalid(name, value, f"{low:g} … {high:g}")
        return self._session.request(Operation.SET, **parameters)

    def tune(
        self, x: float, y: float, *, start: float | None = None, stop: float | None = None, steps: int = 101
    ) -> TuningCurve:
        """Sweep the interrogation wavelength at one point of the film, with the excitation laser off.

        Parameters
        ----------
        x, y
            Position in m.
        start, stop
            Range of the sweep in m; by default all the scanner can do.
        steps
            Wavelengths in the sweep, 2 … 256.
        """
        self._must_not_be_latched()
        low, high = self.capabilities.wavelength
        ends = (low if start is None else start, high if stop is None else stop)
        request = {
            "x": round(x * 1e9),
            "y": round(y * 1e9),
            "from_pm": round(ends[0] * 1e12),
            "to_pm": round(ends[1] * 1e12),
            "steps": steps,
        }
        within = 15.0 + 3 * steps * self.capabilities.tuning_time  # a device may take longer than it states
        levels = self._session.request(Operation.TUNE_SCAN, within=within, **request)["dc_mv"]
        wavelengths = np.linspace(request["from_pm"], request["to_pm"], steps).round() * 1e-12
        return TuningCurve(wavelengths, np.asarray(levels, dtype=np.float64) * 1e-3)

    def pretune(self, points: ArrayLike, *, steps: int = 101) -> TuningMap:
        """Sweep the interrogation wavelength at each of (M, 2) points (m) and return the tuning map."""
        where = np.asarray(points, dtype=np.float64)
        if where.ndim != 2 or where.shape[1] != 2 or len(where) == 0:
            raise PlanInvalid("points", f"shape {where.shape}", "(M, 2), M ≥ 1, in m")
        return TuningMap.from_curves(where, [self.tune(x, y, steps=steps) for x, y in where.tolist()])

    def statistics(self) -> dict[str, Any]:
        """Return counters of host and device: device values as in STATUS, host values with prefix ``host_``."""
        answer = self._session.request(Operation.GET)
        counters, assembly = self._host.deframer.counters, self._host.assembly
        answer |= {
            "host_good_frames": counters.good,
            "host_bad_frames": counters.bad,
            "host_foreign_frames": self._host.foreign_frames,
            "host_bytes": counters.bytes_in,
            "host_gone": self._host.gone,
            "host_reconnects": self._session.reconnects,
            "host_resumes": self._keeper.resumes,
            "host_restarts": self._keeper.restarts,
        }
        if assembly is not None:
            answer |= {
                "host_repairs": assembly.repairs,
                "host_duplicates": assembly.duplicates,
                "host_damaged": assembly.damaged,
            }
        return answer
