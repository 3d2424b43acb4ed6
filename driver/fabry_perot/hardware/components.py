"""Component interfaces (typing protocols) of a scanner: galvo, lasers, digitiser and shutter.

No call waits and none needs to be fast: what takes time is started by one call and asked after by another. Shots are
taken by the hardware's own triggers: the laser's trigger (or sync) output starts a record of the digitiser and steps
the galvo through a table; software only arms them, once a block. Times are device time in µs, positions nm on the film,
wavelengths pm. Any call may raise :class:`~fabry_perot.hardware.InstrumentError`, or whatever its library raises.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fabry_perot.hardware.instrument import PlanSampling


@dataclass(frozen=True, slots=True, eq=False)
class BeamPath:
    """Path of the interrogation beam during a block of shots.

    Parameters
    ----------
    x, y
        (P,) positions in nm.
    shots
        (P,) triggers at each position, before the step to the next.
    settle
        (P,) µs to wait at each beyond the galvo's own settling.
    """

    x: NDArray[np.int64]
    y: NDArray[np.int64]
    shots: NDArray[np.int64]
    settle: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class TriggerRecord:
    """Digitiser record of one trigger: samples, scale, time and quality.

    Parameters
    ----------
    samples
        (N_t,) counts in the range of int16, N_t as asked for; a digitiser with more bits, or that averages itself, may
        give fractions.
    scale
        Pressure unit per count.
    time
        Device time of the trigger, in µs.
    shot
        The laser's own count at this trigger.
    energy
        Pulse energy relative to nominal, in 10⁻⁴.
    wavelength
        Interrogation wavelength in pm.
    dc
        DC level in mV.
    quality
        Bits of ``ALineMeta.quality``.
    time_zero
        Time of the first sample after the pulse, in 100 ps.
    gain
        Gain over the usual one, in 0.01 dB; ``scale`` has taken it into account.
    beam
        Which of the interrogation beams it records, from 0.
    """

    samples: NDArray[np.generic]
    scale: float
    time: int
    shot: int = 0
    energy: int = 10_000
    wavelength: int = 0
    dc: int = 0
    quality: int = 0
    time_zero: int = 0
    gain: int = 0
    beam: int = 0


class Galvo(Protocol):
    """Mirrors that steer the interrogation beam over the film."""

    steps_by_trigger: bool
    """Whether it steps through a path by itself, a trigger a shot, and holds the laser's gate until it has settled.

    Otherwise paths have one position, and software waits for each.
    """

    def limits(self) -> dict[str, Any]:
        """Return the position ranges ``x_nm`` and ``y_nm``, [lowest, highest] each."""
        ...

    def start_path(self, path: BeamPath, now: int) -> None:
        """Move to the first position of a path; after each position's shots, step to the next."""
        ...

    def is_settled(self, now: int) -> bool:
        """Return whether the beam rests at the first position of the path."""
        ...

    def park(self, now: int) -> None:
        """Move to the rest position."""
        ...

    def position(self) -> tuple[int, int]:
        """Return the position x, y in nm."""
        ...


class InterrogationLaser(Protocol):
    """Tunable continuous-wave laser that interrogates the film."""

    def limits(self) -> dict[str, Any]:
        """Return ``wavelength_pm`` [lowest, highest], ``tuning_us``, and the ranges of ``parameters`` by name."""
        ...

    def bias(self, x: int, y: int) -> int:
        """Return the wavelength for a point without one in its plan: from a map of the film, or constant."""
        ...

    def tune(self, wavelength: int, now: int) -> None:
        """Start tuning to a wavelength."""
        ...

    def tuned(self, now: int) -> bool:
        """Return whether the laser has reached the wavelength."""
        ...

    def parameters(self) -> dict[str, int]:
        """Return the values of the adjustable parameters, by name."""
        ...

    def configure(self, name: str, value: int) -> None:
        """Set an adjustable parameter."""
        ...


class Digitiser(Protocol):
    """Digitiser card that records the film's reflection, one record per trigger, in its own ring buffer."""

    def limits(self) -> dict[str, Any]:
        """Return ``samples`` and ``interval_ps``, [lowest, highest] each, and ``adc_bits``."""
        ...

    def begin(self, sampling: PlanSampling) -> None:
        """Set record length, sampling interval and number of beams for a plan."""
        ...

    def arm(self, records: int, now: int) -> None:
        """Accept the next ``records`` triggers."""
        ...

    def records(self, now: int) -> list[TriggerRecord]:
        """Return the records finished since the last call, in the order of their triggers.

        Where there are several beams, each trigger gives a record of each, in their order.
        """
        ...

    def disarm(self) -> None:
        """Ignore further triggers, and discard records that were not read."""
        ...

    def level(self, now: int) -> int:
        """Return the present DC level of the reflected light, in mV."""
        ...


class ExcitationLaser(Protocol):
    """Pulsed laser that generates the ultrasound, and the gate of its pulses."""

    def limits(self) -> dict[str, Any]:
        """Return the range ``pulse_rate_mhz`` [lowest, highest], and the ranges of ``parameters`` by name.

        With ``gate``: true, it is a :class:`GatedLaser`. Where a photodiode tells each pulse's energy (a record's
        ``energy``): ``energy_nj``, what is nominal, and ``energy_range``, [lowest, highest] of it in 10⁻⁴, beyond which
        a pulse is a misfire.
        """
        ...

    def begin(self, sampling: PlanSampling) -> None:
        """Set the pulse rate for a plan; no pulse is emitted."""
        ...

    def permit(self, until: int, now: int) -> None:
        """Permit pulses before ``until`` only, by a hardware timer, so that a hung program cannot extend it."""
        ...

    def fire(self, pulses: int, now: int) -> None:
        """Emit the next ``pulses`` pulses, as far as they are permitted."""
        ...

    def halt(self, now: int) -> None:
        """Stop emission of pulses."""
        ...

    def shots(self) -> int:
        """Return the number of emitted pulses, a count that no reboot resets."""
        ...

    def last_shot(self) -> int:
        """Return the time of the last emitted pulse, 0 before the first."""
        ...

    def emitting(self) -> bool:
        """Return whether light may be emitted, according to the laser's own monitor."""
        ...

    def parameters(self) -> dict[str, int]:
        """Return the values of the adjustable parameters, by name."""
        ...

    def configure(self, name: str, value: int) -> None:
        """Set an adjustable parameter."""
        ...


class GatedLaser(ExcitationLaser, Protocol):
    """Excitation laser with a gate input, which synchronises pulses with a heartbeat, a breath or a stimulus."""

    def fire_at_gate(self, pulses: int, now: int) -> None:
        """Emit ``pulses`` pulses from the next edge at the gate input, as far as they are permitted then.

        A permission that runs out before the last of them is followed by :meth:`halt`, never made up for.
        """
        ...


class Shutter(Protocol):
    """Shutter in the excitation beam, with its interlock and key switch."""

    def open(self) -> None:
        """Open the shutter, if interlock and key permit it."""
        ...

    def close(self) -> None:
        """Close the shutter; no effect on a closed one."""
        ...

    def is_open(self) -> bool:
        """Return whether the shutter is not fully closed, according to its own sensor."""
        ...

    def interlock_closed(self) -> bool:
        """Return whether the enclosure's interlock is closed."""
        ...

    def key_on(self) -> bool:
        """Return whether the key switch is on."""
        ...
