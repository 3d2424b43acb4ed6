"""Simulated hardware components: galvo, lasers, digitiser and shutter.

They implement :mod:`fabry_perot.hardware.components`. Pulses leave at the times of a free-running laser while the gate
is open: the galvo rests, the shutter is open, interlock and key are closed, and the hardware's timer has not run out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from fabry_perot.hardware import BeamPath, PlanSampling, TriggerRecord
from fabry_perot.simulator.motion import Mirrors, PulseTrain
from fabry_perot.simulator.signal_path import SignalPath

TUNING_STEP = 200
"""Time that the interrogation laser takes to another wavelength unless told otherwise, in µs."""
HALF_APERTURE = 10_000_000
"""Reach of the galvo to either side, in nm."""


class SimulatedGalvo:
    """Simulated galvo: two mirrors that step to the next position by trigger."""

    steps_by_trigger = True

    def __init__(self) -> None:
        self._mirrors = Mirrors()
        self._path: BeamPath | None = None
        self._left = 0
        self.step = 0
        """Which position of the path it is at, or on the way to."""
        self.rests_at = 0
        """When the beam has settled."""

    def limits(self) -> dict[str, Any]:
        """Return the position ranges of the beam in nm."""
        reach = [-HALF_APERTURE, HALF_APERTURE]
        return {"x_nm": reach, "y_nm": reach}

    def start_path(self, path: BeamPath, now: int) -> None:
        """Move to the first position of a path."""
        self._path, self.step = path, 0
        self._go(now)

    def _go(self, now: int) -> None:
        path = self._path
        if path is not None:
            self._left = int(path.shots[self.step])
            arrival = self._mirrors.move(int(path.x[self.step]), int(path.y[self.step]), now)
            self.rests_at = arrival + int(path.settle[self.step])

    def is_settled(self, now: int) -> bool:
        """Return whether the beam rests at its position."""
        return now >= self.rests_at

    def trigger(self, time: int) -> None:
        """Count a shot, and step to the next position after a position's last shot."""
        self._left -= 1
        if self._left == 0 and self._path is not None and self.step + 1 < len(self._path.x):
            self.step += 1
            self._go(time)

    def park(self, now: int) -> None:
        """Do nothing, because the simulated beam may rest anywhere."""

    def position(self) -> tuple[int, int]:
        """Return the beam position x, y in nm."""
        return self._mirrors.x, self._mirrors.y


class SimulatedLaser:
    """Simulated interrogation laser, tunable in wavelength and power.

    Parameters
    ----------
    recorder
        Has the film, and the power on it.
    step
        Time to another wavelength, in µs.
    """

    def __init__(self, recorder: SignalPath, step: int = TUNING_STEP) -> None:
        self._recorder, self._step = recorder, step
        self.free_at = 0
        """Until then a record is being taken, and it must not tune."""
        self.wavelength = recorder.bias(0, 0)
        self.rests_at = 0
        """When it is tuned."""

    def limits(self) -> dict[str, Any]:
        """Return the ranges of wavelength and power, and the tuning time."""
        return {
            "wavelength_pm": [1_545_000, 1_555_000],
            "tuning_us": self._step,
            "parameters": {"interrogation_uw": [100, 5000]},
        }

    def bias(self, x: int, y: int) -> int:
        """Return the film's optimum bias wavelength at a point, which the simulator knows."""
        return self._recorder.bias(x, y)

    def tune(self, wavelength: int, now: int) -> None:
        """Start tuning to a wavelength."""
        if wavelength != self.wavelength:
            self.wavelength, self.rests_at = wavelength, max(now, self.free_at) + self._step

    def tuned(self, now: int) -> bool:
        """Return whether the laser has reached the wavelength."""
        return now >= self.rests_at

    def parameters(self) -> dict[str, int]:
        """Return the power of the laser in µW."""
        return {"interrogation_uw": self._recorder.power}

    def configure(self, name: str, value: int) -> None:
        """Set the power of the laser in µW."""
        self._recorder.power = value


class SimulatedShutter:
    """Simulated shutter with interlock and key switch."""

    def __init__(self) -> None:
        self._open = False
        self.closed = self.key = True
        """Whether the interlock is closed, and the key on."""

    def open(self) -> None:
        """Open the shutter."""
        self._open = True

    def close(self) -> None:
        """Close the shutter."""
        self._open = False

    def is_open(self) -> bool:
        """Return whether the shutter is open."""
        return self._open

    def interlock_closed(self) -> bool:
        """Return whether the interlock is closed."""
        return self.closed

    def key_on(self) -> bool:
        """Return whether the key is on."""
        return self.key


class SimulatedExcitation:
    """Simulated pulsed excitation laser with a gate for its pulses.

    Parameters
    ----------
    recorder
        Has the object, which absorbs as the wavelength lets it.
    shutter, galvo
        Hold the gate.
    seed
        Of the pulses' jitter.
    gate
        Time between edges at its gate input, in µs; 0: it has none.
    """

    def __init__(
        self, recorder: SignalPath, shutter: SimulatedShutter, galvo: SimulatedGalvo, seed: int, gate: int = 0
    ) -> None:
        self._gate = gate
        self._recorder, self._shutter, self._galvo = recorder, shutter, galvo
        self._train = PulseTrain(seed)
        self.trigger: Callable[[int], None] = lambda time: None
        """The cable: called at the time of each pulse that leaves."""
        self._count = 0
        self.boot()

    def boot(self) -> None:
        """Reset times and permission, as after a boot of the device."""
        self._left = self._armed = self._until = self._last = 0

    def limits(self) -> dict[str, Any]:
        """Return the ranges of pulse rate, pulse energy and wavelength, and whether there is a gate input."""
        limits = {"pulse_rate_mhz": [1_000, 10_000_000], "energy_nj": 20_000_000, "energy_range": [5_000, 15_000]}
        return {**limits, "gate": self._gate > 0, "parameters": {"excitation_pm": [400_000, 2_000_000]}}

    def begin(self, sampling: PlanSampling) -> None:
        """Set the pulse rate for a plan."""
        self._train.rate(sampling.pulse_rate_mhz)

    def permit(self, until: int, now: int) -> None:
        """Permit pulses before ``until``, after processing pulses due by now under the earlier limit."""
        self.advance(now)
        self._until = until

    def fire(self, pulses: int, now: int) -> None:
        """Open the gate for ``pulses`` pulses."""
        self._left, self._armed = pulses, now

    def fire_at_gate(self, pulses: int, now: int) -> None:
        """Open the gate for ``pulses`` pulses at the next edge of the gate input."""
        self.fire(pulses, -(-(now + 1) // self._gate) * self._gate)

    def halt(self, now: int) -> None:
        """Close the gate, so that no further pulses are emitted."""
        self.advance(now)
        self._left = 0

    def due(self) -> int | None:
        """Return the time of the next pulse, ``None`` without one."""
        if not self._left or not self.emitting():
            return None
        time = self._train.next_pulse(max(self._armed, self._last + 1, self._galvo.rests_at))
        return time if time < self._until else None

    def advance(self, now: int) -> None:
        """Emit the pulses due until ``now``."""
        while (time := self.due()) is not None and time <= now:
            self._left -= 1
            self._count += 1
            self._last = time
            self.trigger(time)
        self._armed = max(self._armed, now)  # a pulse that was held back is not made up for

    def shots(self) -> int:
        """Return the number of pulses emitted since the simulator started."""
        return self._count

    def last_shot(self) -> int:
        """Return the time of the last emitted pulse."""
        return self._last

    def emitting(self) -> bool:
        """Return whether shutter, interlock and key permit emission."""
        return self._shutter.is_open() and self._shutter.closed and self._shutter.key

    def parameters(self) -> dict[str, int]:
        """Return the excitation wavelength in pm."""
        return {"excitation_pm": self._recorder.excitation}

    def configure(self, name: str, value: int) -> None:
        """Set the excitation wavelength in pm."""
        self._recorder.excitation = value


class SimulatedDigitiser:
    """Simulated digitiser, which computes records when they are read.

    Parameters
    ----------
    recorder
        Knows what a shot records.
    galvo, laser
        Tell where and at which wavelength.
    pattern
        Where the beams are beside the first one, in nm.
    """

    def __init__(
        self, recorder: SignalPath, galvo: SimulatedGalvo, laser: SimulatedLaser, pattern: Sequence[tuple[int, int]]
    ) -> None:
        self._recorder, self._galvo, self._laser = recorder, galvo, laser
        self._pattern, self._armed, self._beams = pattern, 0, 1
        self._taken: list[tuple[int, int, int, int, int, int]] = []

    def limits(self) -> dict[str, Any]:
        """Return the ranges of record length and sampling interval, and the ADC resolution."""
        return {"samples": [16, 16384], "interval_ps": [1_000, 1_000_000], "adc_bits": 16}

    def begin(self, sampling: PlanSampling) -> None:
        """Set record length, sampling interval and number of beams for a plan."""
        self._recorder.begin(sampling)
        self._beams = sampling.beams

    def arm(self, records: int, now: int) -> None:
        """Accept the next ``records`` triggers."""
        self._armed = records

    def trigger(self, time: int, shot: int, count: int) -> None:
        """Record a trigger of shot number ``shot`` since boot, the laser's ``count``-th shot, if armed."""
        if self._armed:
            self._armed -= 1
            self._taken.append((*self._galvo.position(), self._laser.wavelength, shot, time, count))

    def records(self, now: int) -> list[TriggerRecord]:
        """Return the records of all triggers since the last call."""
        taken, self._taken = self._taken, []
        return [
            replace(self._recorder.record(x + dx, y + dy, wavelength, shot, beam), time=time, shot=count)
            for x, y, wavelength, shot, time, count in taken
            for beam, (dx, dy) in enumerate(self._pattern[: self._beams])
        ]

    def disarm(self) -> None:
        """Ignore further triggers, and discard records that were not read."""
        self._armed = 0
        self._taken.clear()

    def level(self, now: int) -> int:
        """Return the DC level of the reflected light in mV."""
        return self._recorder.level(*self._galvo.position(), self._laser.wavelength)
