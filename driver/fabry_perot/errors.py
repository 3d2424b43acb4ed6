"""Exception classes of the driver.

ScannerError
├── PlanInvalid            a plan or parameter lies outside the device's limits (also a ``ValueError``)
├── FrameError             bytes are not a valid frame or message (also a ``ValueError``)
├── LinkError              the line between host and device (also a ``ConnectionError``)
│   ├── PortUnavailable    no such port, or it cannot be opened
│   │   └── PortForbidden  this user may not open it
│   ├── PortBusy           another process holds the port
│   ├── ResponseTimeout    nothing answered in time
│   ├── ProtocolMismatch   device and host share no protocol version
│   └── LinkLost           an established link went silent or was unplugged
└── DeviceError            the device answered, and the answer is no
    ├── RequestRejected    a request does not fit the device's state or limits
    ├── LeaseExpired       the laser lease ran out: laser off, data kept; a person's ``resume()`` continues
    ├── ScanAborted        somebody asked for laser off
    ├── DeviceRestarted    the device booted anew; what it had not delivered is gone; likewise
    ├── DeviceFault        a latched fault of the hardware
    ├── FaultStands        a fault cannot be cleared, because its cause still stands
    └── EmergencyStopped   the emergency stop is latched

Every class has a stable ``code`` for logs and for layers above.
"""

from __future__ import annotations

from typing import ClassVar

from fabry_perot import fault_codes


class ScannerError(Exception):
    """Base class of all exceptions of the driver."""

    code: ClassVar[str] = "scanner-error"


class PlanInvalid(ScannerError, ValueError):
    """A plan's value is outside the device's limits.

    Parameters
    ----------
    field
        Name of the parameter, as the caller wrote it.
    value
        What was given.
    allowed
        The allowed range in words, with units.
    """

    code = "plan-invalid"

    def __init__(self, field: str, value: object, allowed: str) -> None:
        self.field, self.value, self.allowed = field, value, allowed
        super().__init__(f"{field} is {str(value)[:80]}; allowed: {allowed}")

    def __reduce__(self) -> tuple[type[PlanInvalid], tuple[str, object, str]]:
        return type(self), (self.field, self.value, self.allowed)


class FrameError(ScannerError, ValueError):
    """Bytes are not a valid frame or message."""

    code = "bad-frame"


class LinkError(ScannerError, ConnectionError):
    """Base class of failures of the line between host and device."""

    code = "link-error"


class PortUnavailable(LinkError):
    """The port does not exist or cannot be opened."""

    code = "port-unavailable"


class PortForbidden(PortUnavailable):
    """The user has no permission to open the port."""

    code = "port-forbidden"


class PortBusy(LinkError):
    """The port is in use by another process."""

    code = "port-busy"


class ResponseTimeout(LinkError):
    """The device does not answer within the protocol's time limit."""

    code = "no-answer"


class ProtocolMismatch(LinkError):
    """Device and host have no protocol version in common."""

    code = "protocol-mismatch"


class LinkLost(LinkError):
    """An established link was silent for too long or was unplugged."""

    code = "link-lost"


class DeviceError(ScannerError):
    """Base class of errors that the device itself reports."""

    code = "device-error"


class RequestRejected(DeviceError):
    """The device rejected a request of the host.

    Parameters
    ----------
    operation
        Name of the request.
    reason
        The device's reason as a word (see :class:`fabry_perot.wire.constants.Result`).
    state
        Name of the state the device was in.
    """

    code = "refused"

    def __init__(self, operation: str, reason: str, state: str) -> None:
        self.operation, self.reason, self.state = operation, reason, state
        super().__init__(f"the device refused {operation}: {reason} (state {state})")

    def __reduce__(self) -> tuple[type[RequestRejected], tuple[str, str, str]]:
        return type(self), (self.operation, self.reason, self.state)


class LeaseExpired(DeviceError):
    """The laser lease has expired: the laser is off, plan and data are retained; ``resume()`` continues."""

    code = "lease-lapsed"


class ScanAborted(DeviceError):
    """The laser was switched off on request; plan and data are retained."""

    code = "scan-aborted"


class DeviceRestarted(DeviceError):
    """The device has rebooted; undelivered A-lines are lost."""

    code = "device-restarted"

    def __init__(self, message: str = "the scanner restarted; A-lines it had not delivered are gone") -> None:
        super().__init__(message)


class DeviceFault(DeviceError):
    """Hardware fault that the device has latched; the message has the fault, its remedy and the clearing command.

    Parameters
    ----------
    fault
        The fault's code, as in STATUS (:mod:`fabry_perot.fault_codes`).
    port
        The scanner's port, for the command in the message.
    text
        What the device says of the fault, for example an instrument's own words.
    """

    code = "device-fault"

    def __init__(self, fault: int, port: str = "PORT", text: str = "") -> None:
        self.fault, self.port, self.text = fault, port, text
        super().__init__(fault_codes.advice(fault, port) + (f" (scanner: {text})" if text else ""))

    def __reduce__(self) -> tuple[type[DeviceFault], tuple[int, str, str]]:
        return type(self), (self.fault, self.port, self.text)


class FaultStands(DeviceError):
    """A fault was not cleared, because its cause persists.

    Parameters
    ----------
    fault
        The fault's code, as in STATUS; 0 for the latched emergency stop.
    cause
        The cause that stands, as a clause (:func:`fabry_perot.fault_codes.standing`).
    """

    code = "fault-stands"

    def __init__(self, fault: int, cause: str) -> None:
        self.fault, self.cause = fault, cause
        known = fault_codes.by_code(fault)
        super().__init__(f"{cause}, so the fault {known.name} was not cleared; {known.remedy} first")

    def __reduce__(self) -> tuple[type[FaultStands], tuple[int, str]]:
        return type(self), (self.fault, self.cause)


class EmergencyStopped(DeviceError):
    """The emergency stop is latched, so that the scanner rejects work until a person clears it."""

    code = "emergency-stop"
