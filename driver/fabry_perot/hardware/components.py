"""Protocols of the components of a scanner.

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
    """Path of the beam during a block of shots.

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
    """Digitiser record of one trigger.

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
    """The mirrors that steer the interrogation beam over the film."""

    steps_by_trigger: bool
    """Whether it steps through a path by itself, a trigger a shot, and holds the laser's gate until it has settled.

    Otherwise paths have one position, and software waits for each.
    """

    def limits(self) -> dict[str, Any]:
        """Return ``x_nm`` and ``y_nm``, [lowest, highest] each."""
        ...

    def start_path(self, path: BeamPath, now: int) -> None:
        """Go to the first position, and after each position's shots to the next."""
        ...

    def is_settled(self, now: int) -> bool:
        """Return whether the beam rests at the first position of the path."""
        ...

    def park(self, now: int) -> None:
        """Go to the rest position."""
        ...

    def position(self) -> tuple[int, int]:
        """Return x, y."""
        ...


class InterrogationLaser(Protocol):
    """The tunable continuous laser that reads the film."""

    def limits(self) -> dict[str, Any]:
        """Return ``wavelength_pm`` [lowest, highest], ``tuning_us``, and ``parameters``, name to [lowest, highest]."""
        ...

    def bias(self, x: int, y: int) -> int:
        """Return the wavelength for a point whose plan names none: from a map of the film, or the same everywhere."""
        ...

    def tune(self, wavelength: int, now: int) -> None:
        """Begin to tune."""
        ...

    def tuned(self, now: int) -> bool:
        """Return whether it is there."""
        ...

    def parameters(self) -> dict[str, int]:
        """Return the adjustable parameters, by name."""
        ...

    def configure(self, name: str, value: int) -> None:
        """Change a parameter."""
        ...


class Digitiser(Protocol):
    """The card that records the film's reflection, a record a trigger, into a ring of its own."""

    def limits(self) -> dict[str, Any]:
        """Return ``samples`` and ``interval_ps``, [lowest, highest] each, and ``adc_bits``."""
        ...

    def begin(self, sampling: PlanSampling) -> None:
        """Set up length and interval of records, and of how many beams."""
        ...

    def arm(self, records: int, now: int) -> None:
        """Accept ``count`` triggers."""
        ...

    def records(self, now: int) -> list[TriggerRecord]:
        """Return the records finished since the last call, in the order of their triggers.

        Where there are several beams, each trigger gives a record of each, in their order.
        """
        ...

    def disarm(self) -> None:
        """Accept no more triggers, and discard records that were not fetched."""
        ...

    def level(self, now: int) -> int:
        """Return the DC level now, in mV."""
        ...


class ExcitationLaser(Protocol):
    """The pulsed laser that makes the sound, and the gate of its pulses."""

    def limits(self) -> dict[str, Any]:
        """Return ``pulse_rate_mhz`` [lowest, highest], and ``parameters``, name to [lowest, highest].

        With ``gate``: true, it is a :class:`GatedLaser`. Where a photodiode tells each pulse's energy (a record's
        ``energy``): ``energy_nj``, what is nominal, and ``energy_range``, [lowest, highest] of it in 10⁻⁴, beyond which
        a pulse is a misfire.
        """
        ...

    def begin(self, sampling: PlanSampling) -> None:
        """Set the pulse rate; no pulse leaves."""
        ...

    def permit(self, until: int, now: int) -> None:
        """Permit pulses before ``until`` only, by a hardware timer, so that a hung program cannot extend it."""
        ...

    def fire(self, pulses: int, now: int) -> None:
        """Emit the next ``count`` pulses, as far as they are permitted."""
        ...

    def halt(self, now: int) -> None:
        """Stop emission."""
        ...

    def shots(self) -> int:
        """Return the count of pulses that left, which no reboot sets back."""
        ...

    def last_shot(self) -> int:
        """Return the time of the last pulse that left, 0 before the first."""
        ...

    def emitting(self) -> bool:
        """Return whether light may leave the aperture, by the laser's own monitor."""
        ...

    def parameters(self) -> dict[str, int]:
        """Return the adjustable parameters, by name."""
        ...

    def configure(self, name: str, value: int) -> None:
        """Change a parameter."""
        ...


class GatedLaser(ExcitationLaser, Protocol):
    """An excitation laser that can wait for something else: a heart, a breath, a stimulus."""

    def fire_at_gate(self, pulses: int, now: int) -> None:
        """Emit ``count`` pulses from the next edge at the gate input, as far as they are permitted then.

        A permission that runs out before the last of them is followed by :meth:`halt`, never made up for.
        """
        ...


class Shutter(Protocol):
    """The shutter in the excitation beam, and the loop of interlock and key that holds it."""

    def open(self) -> None:
        """Open it, if interlock and key let it."""
        ...

    def close(self) -> None:
        """Close it; harmless where it is closed."""
        ...

    def is_open(self) -> bool:
        """Return whether it is not wholly closed, by its own sensor."""
        ...

    def interlock_closed(self) -> bool:
        """Return whether the enclosure's interlock is closed."""
        ...

    def key_on(self) -> bool:
        """Return whether the key switch is on."""
        ...
