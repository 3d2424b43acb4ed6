"""Driver, protocol and simulator of a Fabry–Pérot photoacoustic scanner on a serial line.

The *device* is the scanner's firmware side (:mod:`fabry_perot.device`), the *driver* the host side
(:mod:`fabry_perot.host`, :func:`connect`), the *link* the bytes between them (``PROTOCOL.md``).
"""

from fabry_perot.aline import ALine
from fabry_perot.capabilities import Capabilities
from fabry_perot.errors import (
    DeviceError,
    DeviceFault,
    DeviceRestarted,
    EmergencyStopped,
    LeaseLapsed,
    LinkError,
    LinkLost,
    NoAnswer,
    PlanInvalid,
    PortBusy,
    PortUnavailable,
    Refused,
    ScanAborted,
    ScannerError,
)
from fabry_perot.scanner import Scanner, connect

__all__ = [
    "ALine",
    "Capabilities",
    "DeviceError",
    "DeviceFault",
    "DeviceRestarted",
    "EmergencyStopped",
    "LeaseLapsed",
    "LinkError",
    "LinkLost",
    "NoAnswer",
    "PlanInvalid",
    "PortBusy",
    "PortUnavailable",
    "Refused",
    "ScanAborted",
    "Scanner",
    "ScannerError",
    "connect",
]
