"""Hardware interface of the device: non-blocking operations on blocks of points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


class InstrumentError(Exception):
    """Hardware fault with its code, raised by an instrument.

    Parameters
    ----------
    fault
        Fault code for STATUS and FAULT, not 0.
    """

    def __init__(self, fault: int, message: str) -> None:
        self.fault = fault
        super().__init__(message)


@dataclass(frozen=True, slots=True)
class PlanSampling:
    """Sampling parameters common to all points of a plan.

    Parameters
    ----------
    samples
        Samples per A-line.
    interval_ps
        Sampling interval in ps.
    pulse_rate_mhz
        Pulse rate in mHz.
    beams
        Interrogation beams that are recorded at each point: the first so many of the pattern.
    """

    samples: int
    interval_ps: int
    pulse_rate_mhz: int
    beams: int = 1


@dataclass(frozen=True, slots=True)
class PointRecord:
    """Averaged record of one point and beam.

    Parameters
    ----------
    samples
        (N_t,) int16 counts.
    scale
        Pressure unit per count.
    point
        Index as :meth:`Instrument.queue_points` counts them.
    fire_time
        Device time of the last shot, in µs.
    shot
        The laser's own count at the last shot.
    averages
        Shots taken.
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
    beam
        Which of the beams, from 0.
    """

    samples: NDArray[np.int16]
    scale: float
    point: int = 0
    fire_time: int = 0
    shot: int = 0
    averages: int = 1
    energy: int = 10_000
    wavelength: int = 0
    dc: int = 0
    quality: int = 0
    time_zero: int = 0
    gain: int = 0
    beam: int = 0


class Instrument(Protocol):
    """Interface of the hardware to the device; :class:`~fabry_perot.hardware.ComposedInstrument` implements it.

    No call waits: what takes time is started by one call, and :meth:`poll` or :meth:`sweep_result` tells when it is
    over. Points are worked through by the hardware's own triggers, many to a call. All times are device time in µs.

    Any call may raise :class:`InstrumentError`; the device latches it as a fault, closes the shutter and stops. What a
    read-back cannot tell counts as the worse of both: open, emitting, key off, interlock open.
    """

    def capabilities(self) -> dict[str, Any]:
        """Return the hardware's limits, as documented in ``PROTOCOL.md``."""
        ...

    def begin(self, sampling: PlanSampling) -> None:
        """Configure the hardware for a plan; nothing moves."""
        ...

    def queue_points(self, first: int, points: NDArray[np.void], now: int) -> None:
        """Queue more points for measurement, from index ``first`` on, after those queued before.

        At each: go there (the first beam), tune, settle, take as many shots as its averages say, with all beams that
        ``begin`` was told. The shutter is opened and closed by others; pulses leave only within :meth:`permit`.
        """
        ...

    def permit(self, until: int, now: int) -> None:
        """Permit pulses before ``until`` and none later, even without a further call."""
        ...

    def poll(self, now: int) -> list[PointRecord]:
        """Continue started operations, and return the results finished since the last call.

        In the order of the points; all beams of a point together, in their order.
        """
        ...

    def next_due(self, now: int) -> int | None:
        """Return the time of the next work of :meth:`poll` or :meth:`sweep_result`; ``None`` if nothing was started."""
        ...

    def stop(self, now: int) -> None:
        """Stop firing and discard all points and sweeps.

        Results finished before are returned by one more :meth:`poll`.
        """
        ...

    def shots(self) -> int:
        """Return the laser's own count of shots, which survives a reboot of the device."""
        ...

    def last_shot(self) -> int:
        """Return the time of the last shot, 0 before the first."""
        ...

    def sweep(self, x: int, y: int, wavelengths: NDArray[np.int64], now: int) -> None:
        """Start a sweep of the interrogation wavelength (pm) at a point (nm) of the film, with the shutter closed."""
        ...

    def sweep_result(self, now: int) -> list[int] | None:
        """Return the sweep's DC levels in mV once after its end, otherwise ``None``."""
        ...

    def open(self) -> None:
        """Open the shutter; called on START only."""
        ...

    def close(self) -> None:
        """Close the shutter and stop emission, without waiting; no effect if closed and off."""
        ...

    def shutter_open(self) -> bool:
        """Return whether the shutter is not fully closed, according to its own sensor."""
        ...

    def emitting(self) -> bool:
        """Return whether light may be emitted, according to the laser's own monitor."""
        ...

    def interlock_closed(self) -> bool:
        """Return whether the enclosure's interlock is closed; while open, the laser cannot emit."""
        ...

    def key_on(self) -> bool:
        """Return whether the key switch is on; while off, the laser cannot emit."""
        ...

    def park(self, now: int) -> None:
        """Move to the rest position; the shutter is closed."""
        ...

    def position(self) -> tuple[int, int]:
        """Return the beam position x, y on the film in nm."""
        ...

    def parameters(self) -> dict[str, int]:
        """Return the values of the adjustable parameters, by name."""
        ...

    def configure(self, name: str, value: int) -> None:
        """Set an adjustable parameter; name and range were checked against the capabilities."""
        ...
