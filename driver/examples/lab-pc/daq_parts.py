"""Galvo, pulsed-laser gate and shutter on a DAQ card, by the interface of the package ``nidaqmx``.

``daq`` is that package, or ``bench.cards.Cards``, which has as much of its interface as is used here. Wiring and
terminals are in docs/hardware.md: the pulsed laser's sync output comes back to PFI0 and, later by a record's length, to
PFI1.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from fabry_perot.hardware import BeamPath, GalvoCalibration, PlanSampling

SETTLING = 400
"""Settling time of the mirrors after the longest step, in µs."""


class DaqGalvo:
    """:class:`~fabry_perot.hardware.Galvo` on two analogue outputs that step through a table, one row per trigger."""

    steps_by_trigger = True

    def __init__(self, daq: Any, device: str, calibration: GalvoCalibration, *, reach: float = 7e-3) -> None:
        self._daq, self._device, self._calibration, self._reach = daq, device, calibration, reach
        self._table: Any = None
        self._volts = np.zeros(2)
        self._rests_at = 0
        self.positions = np.zeros((1, 2), np.int64)
        """(T, 2) where each trigger of the present table finds the beam, in nm."""

    def limits(self) -> dict[str, Any]:
        """Return the reach of the beam in nm."""
        reach = round(1e9 * self._reach)
        return {"x_nm": [-reach, reach], "y_nm": [-reach, reach]}

    def start_path(self, path: BeamPath, now: int) -> None:
        """Move to the first position, and load the positions that follow each trigger into the card."""
        if path.settle[1:].any():
            raise ValueError("a table of the card cannot wait: set steps_by_trigger to False for points that settle")
        self.halt()
        self.positions = np.repeat(np.column_stack([path.x, path.y]), np.maximum(path.shots, 1), axis=0)
        volts = self._calibration.volts(1e-9 * self.positions)
        self._go(volts[0])
        self._rests_at = now + SETTLING + int(path.settle[0])
        after = np.concatenate([volts[1:], volts[-1:]])  # a trigger's sample is the place of the next shot
        if len(after) > 1:
            self._table = self._outputs()
            finite = self._daq.constants.AcquisitionType.FINITE
            clock = f"/{self._device}/PFI1"
            self._table.timing.cfg_samp_clk_timing(10_000, source=clock, sample_mode=finite, samps_per_chan=len(after))
            self._table.write(after.T.tolist(), auto_start=False)
            self._table.start()

    def is_settled(self, now: int) -> bool:
        """Return whether the beam rests at the first position."""
        return now >= self._rests_at

    def park(self, now: int) -> None:
        """Move the beam to the centre of the film."""
        self.halt()
        self._go(self._calibration.volts(np.zeros((1, 2)))[0])
        self._rests_at = now + SETTLING

    def position(self) -> tuple[int, int]:
        """Return x, y (nm) of the last position set by software."""
        x, y = self._calibration.metres(self._volts[None])[0]
        return round(1e9 * x), round(1e9 * y)

    def halt(self) -> None:
        """Stop the table of positions on the card."""
        if self._table is not None:
            self._table.close()
            self._table = None

    def _outputs(self) -> Any:
        task = self._daq.Task()
        task.ao_channels.add_ao_voltage_chan(f"{self._device}/ao0:1", min_val=-10.0, max_val=10.0)
        return task

    def _go(self, volts: Any) -> None:
        task = self._outputs()
        task.write(volts.tolist(), auto_start=True)
        task.close()
        self._volts = volts


class CounterGatedLaser:
    """:class:`~fabry_perot.hardware.ExcitationLaser` that fires one pulse per trigger of a counter.

    Counter 0 makes the triggers while counter 1 lets it: a one-shot as long as is permitted, which the card ends by its
    own clock whatever becomes of this program. Counter 2 counts what the laser says it fired (its sync output).
    With a terminal ``edges`` it is a :class:`~fabry_perot.hardware.GatedLaser`: counter 0 starts at an edge there.
    """

    def __init__(self, daq: Any, device: str, *, highest_rate: float = 1_000.0, edges: str = "") -> None:
        self._daq, self._device, self._highest, self._edges = daq, device, highest_rate, edges
        self._rate = 50.0
        self._train: Any = None
        self._gate: Any = None
        self._seen = self._last = self._until = 0
        self._offset = 0.0
        self._count = daq.Task()
        self._count.ci_channels.add_ci_count_edges_chan(f"{device}/ctr2")
        self._count.start()
        self._monitor = daq.Task()
        self._monitor.di_channels.add_di_chan(f"{device}/port0/line4")

    def limits(self) -> dict[str, Any]:
        """Return the ranges of pulse rate and parameters, and whether there is a gate input."""
        return {"pulse_rate_mhz": [1_000, round(1e3 * self._highest)], "gate": bool(self._edges), "parameters": {}}

    def begin(self, sampling: PlanSampling) -> None:
        """Set the pulse rate of a plan."""
        self._rate = 1e-3 * sampling.pulse_rate_mhz

    def permit(self, until: int, now: int) -> None:
        """Program counter 1 to be high until ``until`` and low afterwards."""
        self._synchronise(now)
        self.shots()
        self._gate, self._until = self._over(self._gate), until
        if until > now:
            self._gate = self._daq.Task()
            self._gate.co_channels.add_co_pulse_chan_time(
                f"{self._device}/ctr1", initial_delay=0.0, high_time=1e-6 * (until - now), low_time=1e-6
            )
            self._gate.start()

    def fire(self, pulses: int, now: int) -> None:
        """Start a train of ``pulses`` triggers on counter 0, paused while counter 1 is low."""
        self._start(pulses, now)

    def fire_at_gate(self, pulses: int, now: int) -> None:
        """Start the train of triggers at the next rising edge; an edge while counter 1 is low is lost.

        Then counter 0 would go on in the middle: the permission's end is followed by :meth:`halt`.
        """
        self._start(pulses, now, edges=f"/{self._device}/{self._edges}")

    def _start(self, pulses: int, now: int, edges: str = "") -> None:
        self._synchronise(now)
        self._train = self._over(self._train)
        self._train = self._daq.Task()
        self._train.co_channels.add_co_pulse_chan_freq(f"{self._device}/ctr0", freq=self._rate, duty_cycle=0.01)
        finite = self._daq.constants.AcquisitionType.FINITE
        self._train.timing.cfg_implicit_timing(sample_mode=finite, samps_per_chan=pulses)
        pause = self._train.triggers.pause_trigger
        pause.trig_type = self._daq.constants.TriggerType.DIGITAL_LEVEL
        pause.dig_lvl_src = f"/{self._device}/Ctr1InternalOutput"
        pause.dig_lvl_when = self._daq.constants.Level.LOW
        if edges:
            self._train.triggers.start_trigger.cfg_dig_edge_start_trig(edges)
        self._train.start()

    def halt(self, now: int) -> None:
        """Stop both counters, which ends emission."""
        self._synchronise(now)
        self._train, self._gate = self._over(self._train), self._over(self._gate)

    def shots(self) -> int:
        """Return the count of counter 2; real labs return the laser's own count, which survives a reset of the card."""
        count = int(self._count.read())
        if count != self._seen:
            self._seen, self._last = count, min(round(1e6 * time.monotonic() + self._offset), self._until - 1)
        return count

    def last_shot(self) -> int:
        """Return the time of the last change of the shot count, at most the end of the permission, in µs."""
        self.shots()
        return self._last

    def emitting(self) -> bool:
        """Return whether the photodiode behind the shutter detects light."""
        return bool(self._monitor.read())

    def parameters(self) -> dict[str, int]:
        """Return an empty dictionary, because this laser has no adjustable parameters."""
        return {}

    def configure(self, name: str, value: int) -> None:
        """Raise ValueError, because this laser has no adjustable parameters."""
        raise ValueError(f"no parameter {name}")

    def _synchronise(self, now: int) -> None:
        self._offset = now - 1e6 * time.monotonic()

    def _over(self, task: Any) -> None:
        if task is not None:
            task.close()


class DigitalLineShutter:
    """:class:`~fabry_perot.hardware.Shutter` on digital lines: drive (0), end switch (1), interlock (2), key (3)."""

    def __init__(self, daq: Any, device: str) -> None:
        self._drive, self._sense = daq.Task(), [daq.Task() for _ in range(3)]
        self._drive.do_channels.add_do_chan(f"{device}/port0/line0")
        for line, task in enumerate(self._sense, start=1):
            task.di_channels.add_di_chan(f"{device}/port0/line{line}")
        self.close()

    def open(self) -> None:
        """Drive the shutter line high; the interlock relay is wired between this line and the shutter."""
        self._drive.write(True)

    def close(self) -> None:
        """Drive the shutter line low."""
        self._drive.write(False)

    def is_open(self) -> bool:
        """Return whether the end switch reports that the shutter is not fully closed."""
        return not self._sense[0].read()

    def interlock_closed(self) -> bool:
        """Return whether the interlock line is high."""
        return bool(self._sense[1].read())

    def key_on(self) -> bool:
        """Return whether the key line is high."""
        return bool(self._sense[2].read())
