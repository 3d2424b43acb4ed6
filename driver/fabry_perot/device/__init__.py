"""The scanner's firmware side: a state machine of bytes in, bytes out and an explicit time."""

from fabry_perot.device.core import Device
from fabry_perot.device.timing import DeviceTiming

__all__ = ["Device", "DeviceTiming"]
