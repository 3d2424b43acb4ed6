"""Device side of the protocol as a sans-I/O state machine."""

from fabry_perot.device.device import Device
from fabry_perot.device.timing import DeviceTiming

__all__ = ["Device", "DeviceTiming"]
