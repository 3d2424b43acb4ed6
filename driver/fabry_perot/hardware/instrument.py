"""What the device logic needs from the hardware under it: galvo, laser and digitiser behind one interface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


class InstrumentError(Exception):
    """The hardware reports a fault.

    Parameters
    ----------
    fault
        Fault code for STATUS and FAULT, not 0.
    """

    def __init__(self, fault: int, message: str) -> None:
        self.fault = fault
        super().__init__(message)


@dataclass(frozen=True, slots=True)
class Sampling:
    """Parameters common to all points of a plan.

    Parameters
    ----------
    samples
        Samples per A-line.
    interval_ps
        Sampling interval in ps.
    pulse_rate_mhz
        Pulse rate in mHz.
    """

    samples: int
    interval_ps: int
    pulse_rate_mhz: int


@dataclass(frozen=True, slots=True)
class Interrogation:
    """One interrogation as the digitiser gives it.

    Parameters
    ----------
    samples
        (N_t,) int16 counts, the mean over the averages.
    scale
        Pressure unit per count.
    energy
        Pulse energy relative to nominal, in 10⁻⁴.
    wavelength
        Interrogation wavelength in pm.
    dc
        DC level in mV.
    quality
        Bits of ``ALineMeta.quality``.
    time_zero
        Time of the first sample after the pulse, in 100 ps, as an int32.
    gain
        Gain of the receiver over its usual one, in 0.01 dB; ``scale`` has taken it into account.
    """

    samples: NDArray[np.int16]
    scale: float
    energy: int = 10_000
    wavelength: int = 0
    dc: int = 0
    quality: int = 0
    time_zero: int = 0
    gain: int = 0


class Instrument(Protocol):
    """Galvo, laser and digitiser. All times are device time in µs.

    Any call may raise :class:`InstrumentError`; the device latches it as a fault. What a read-back cannot tell counts
    as the worse of both: open, emitting, key off, interlock open.
    """

    def capabilities(self) -> dict[str, Any]:
        """Return the limits, as documented in :mod:`fabry_perot.host.capabilities`."""
        ...

    def begin(self, sampling: Sampling) -> None:
        """Set up for a plan; nothing moves."""
        ...

    def load(self, first: int, points: NDArray[np.void]) -> None:
        """Learn the points from index ``first``, so work may be done ahead."""
        ...

    def move(self, index: int, now: int) -> int:
        """Start to move to point ``index`` and return when it will have settled."""
        ...

    def next_pulse(self, after: int) -> int:
        """Return the time of the laser's first pulse slot at or after ``after``."""
        ...

    def fire(self, index: int, shot: int, now: int) -> None:
        """Fire one shot at point ``index`` and record it; ``shot`` counts all shots since boot."""
        ...

    def read(self, index: int) -> Interrogation:
        """Return the mean of the shots fired at ``index`` since the last read, and forget them."""
        ...

    def drop(self) -> None:
        """Forget the shots fired since the last read."""
        ...

    def open(self) -> None:
        """Open the shutter; called by START alone."""
        ...

    def close(self) -> None:
        """Close the shutter and stop emission, without waiting for either; harmless where they are closed and off."""
        ...

    def shutter_open(self) -> bool:
        """Return whether the shutter is not wholly closed, by its own sensor."""
        ...

    def emitting(self) -> bool:
        """Return whether light may leave the aperture, by the laser's own monitor."""
        ...

    def park(self) -> None:
        """Go to the rest position; the shutter is closed."""
        ...

    def position(self) -> tuple[int, int]:
        """Return x, y in nm on the film."""
        ...

    def interlock_closed(self) -> bool:
        """Return whether the enclosure's interlock is closed; open, the laser cannot emit."""
        ...

    def key_on(self) -> bool:
        """Return whether the key switch is on; off, the laser cannot emit."""
        ...

    def parameters(self) -> dict[str, int]:
        """Return what SET changes, by name."""
        ...

    def configure(self, name: str, value: int) -> None:
        """Change a parameter; name and range were checked against the capabilities."""
        ...

    def tune(self, x: int, y: int, wavelengths: NDArray[np.int64], now: int) -> tuple[list[int], int]:
        """Sweep the interrogation wavelength (pm) at a point: the DC levels in mV, and when the sweep ends."""
        ...

    def laser_shots(self) -> int:
        """Return the laser's own count of shots, which survives a reboot of the device."""
        ...
