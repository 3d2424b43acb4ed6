"""Timeouts of the device."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class DeviceTiming:
    """Time limits in µs of device time.

    Parameters
    ----------
    status_period
        Between two STATUS when nothing changes.
    lease_cap
        Longest lease granted.
    arm_timeout
        An arm token not used for so long is withdrawn.
    fault_period
        Between repetitions of an unacknowledged FAULT.
    shutter
        Longest the shutter takes to close; the hardware's own time, no delay of host or line.
    """

    status_period: int = 100_000
    lease_cap: int = 1_000_000
    arm_timeout: int = 30_000_000
    fault_period: int = 100_000
    shutter: int = 50_000

    def scaled(self, rate: float) -> DeviceTiming:
        """Return the time limits for a device with a clock that runs ``rate`` times as fast as its host's.

        The limits stand for delays of host and line, which a faster simulated clock does not make any shorter.
        """
        return DeviceTiming(
            int(self.status_period * rate),
            int(self.lease_cap * rate),
            int(self.arm_timeout * rate),
            int(self.fault_period * rate),
            self.shutter,
        )
