"""Driver, protocol and simulator of a Fabry–Pérot scanner on a serial line.

The *device* is the scanner's firmware side (:mod:`fabry_perot.device`), the *driver* the host side
(:mod:`fabry_perot.host`, :func:`connect`), the *link* the bytes between them (``PROTOCOL.md``). Hardware is described
by :mod:`fabry_perot.hardware`; :func:`serve` makes a computer that has it a device.
"""

from fabry_perot import fault_codes
from fabry_perot.device.serve import serve
from fabry_perot.errors import (
    DeviceError,
    DeviceFault,
    DeviceRestarted,
    EmergencyStopped,
    FaultStands,
    LeaseExpired,
    LinkError,
    LinkLost,
    PlanInvalid,
    PortBusy,
    PortForbidden,
    PortUnavailable,
    RequestRejected,
    ResponseTimeout,
    ScanAborted,
    ScannerError,
)
from fabry_perot.hardware import ComposedInstrument, Instrument, InstrumentError
from fabry_perot.host import RecoveryPolicy, ScanReport
from fabry_perot.host.aline import ALine, ALineBatch
from fabry_perot.host.capabilities import Capabilities
from fabry_perot.host.discovery import DiscoveredPort, connect, discover
from fabry_perot.host.emergency_stop import emergency_stop, port_status
from fabry_perot.host.monitor import Monitor
from fabry_perot.host.scanner import Scanner
from fabry_perot.host.stop_and_status_results import FaultCleared, PortStatus, StopAnswer
from fabry_perot.host.tuning import TuningCurve, TuningDrift, TuningMap

__all__ = [
    "ALine",
    "ALineBatch",
    "Capabilities",
    "ComposedInstrument",
    "DeviceError",
    "DeviceFault",
    "DeviceRestarted",
    "DiscoveredPort",
    "EmergencyStopped",
    "FaultCleared",
    "FaultStands",
    "Instrument",
    "InstrumentError",
    "LeaseExpired",
    "LinkError",
    "LinkLost",
    "Monitor",
    "PlanInvalid",
    "PortBusy",
    "PortForbidden",
    "PortStatus",
    "PortUnavailable",
    "RecoveryPolicy",
    "RequestRejected",
    "ResponseTimeout",
    "ScanAborted",
    "ScanReport",
    "Scanner",
    "ScannerError",
    "StopAnswer",
    "TuningCurve",
    "TuningDrift",
    "TuningMap",
    "connect",
    "discover",
    "emergency_stop",
    "fault_codes",
    "port_status",
    "serve",
]
