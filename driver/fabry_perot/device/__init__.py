"""Device side of the protocol: a state machine without I/O, and its endpoints and event loop."""

from fabry_perot.device.device import Device
from fabry_perot.device.timing import DeviceTiming

__all__ = ["Device", "DeviceTiming"]
