"""Simulated instrument: simulated components that measure a phantom, and a log of every shot."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabry_perot.hardware import ComposedInstrument, PointRecord
from fabry_perot.hardware.averaging import average_shots
from fabry_perot.simulator.components import (
    TUNING_STEP,
    SimulatedDigitiser,
    SimulatedExcitation,
    SimulatedGalvo,
    SimulatedLaser,
    SimulatedShutter,
)
from fabry_perot.simulator.phantoms import Balls
from fabry_perot.simulator.shot_log import ShotLog
from fabry_perot.simulator.signal_path import SignalPath

SHOT_LOG_SIZE = 200_000
"""Shots remembered."""
TRACKED_PHANTOMS = 256
"""Places of points to come that the recorder knows, at most."""


class SimulatedInstrument(ComposedInstrument):
    """Simulated instrument that measures a phantom.

    By default the film is ideal: A-lines are the phantom's closed-form pressure plus noise. ``response`` makes it real.
    What happens between two calls happens at its own time, to the µs, however late the second one comes.

    Parameters
    ----------
    balls
        The object.
    seed
        Of noise, pulse energies, jitter and film.
    clock_rate
        Device seconds per host second, as told to the host.
    line_rate
        Bytes per device second the line carries, as told to the host; 0 for unlimited.
    tuning
        Time in which the interrogation laser tunes, in µs.
    gate
        Time between edges at the gate input, in µs; 0: there is none.
    beams
        (B, 2) where the interrogation beams are beside the first one, in nm.
    settings
        Further ones of :class:`~fabry_perot.simulator.signal_path.SignalPath`.
    """

    galvo: SimulatedGalvo
    laser: SimulatedLaser
    digitiser: SimulatedDigitiser
    excitation: SimulatedExcitation
    shutter: SimulatedShutter

    def __init__(
        self,
        balls: Balls,
        *,
        seed: int = 0,
        clock_rate: float = 1.0,
        line_rate: int = 0,
        tuning: int = TUNING_STEP,
        gate: int = 0,
        beams: Sequence[tuple[int, int]] = ((0, 0),),
        **settings: Any,
    ) -> None:
        self.recorder = SignalPath(balls, seed=seed, **settings)
        galvo, shutter, laser = SimulatedGalvo(), SimulatedShutter(), SimulatedLaser(self.recorder, tuning)
        excitation = SimulatedExcitation(self.recorder, shutter, galvo, seed, gate)
        super().__init__(
            galvo=galvo,
            laser=laser,
            digitiser=SimulatedDigitiser(self.recorder, galvo, laser, beams),
            excitation=excitation,
            shutter=shutter,
            model="simulated Fabry-Perot scanner",
            serial=f"SIM-{seed:04d}",
            beams=beams,
        )
        excitation.trigger = self._trigger
        self._rates = {"clock_rate": clock_rate, "line_rate": line_rate}
        self.epoch = 0
        """Simulator time at which the device booted, in µs."""
        self.log = ShotLog(SHOT_LOG_SIZE)
        """Simulator time (µs) and point of the last shots: the truth that no reboot and no line can change."""
        self._before = 0
        self._points: list[int] = []
        self._places: deque[tuple[int, int]] = deque(maxlen=TRACKED_PHANTOMS)

    def boot(self, now: int) -> None:
        """Handle a boot of the device at simulator time ``now``: device time and shot count restart."""
        self.stop(now - self.epoch)
        self.epoch, self._before = now, self.excitation.shots()
        self._done.clear()
        self.excitation.boot()
        self.galvo.rests_at = self.laser.rests_at = self.laser.free_at = 0

    def capabilities(self) -> dict[str, Any]:
        """Return the limits of the simulated hardware."""
        return {**super().capabilities(), **self._rates, "simulated": True, "film": str(self.recorder.response)}

    def queue_points(self, first: int, points: NDArray[np.void], now: int) -> None:
        """Queue more points for measurement."""
        super().queue_points(first, points, now)
        beams = self.pattern[: self._beams]
        for x, y in zip(points["x"].tolist(), points["y"].tolist(), strict=True):
            self._places.extend((x + dx, y + dy) for dx, dy in beams)
        self.recorder.prefetch(list(self._places))

    def poll(self, now: int) -> list[PointRecord]:
        """Advance the simulation to ``now``."""
        done: list[PointRecord] = []
        while True:
            self.excitation.advance(now)
            done += super().poll(now)
            due = self.excitation.due() if self._firing else None
            if not (self._queue and not self._block) and (due is None or due > now):
                return done

    def next_due(self, now: int) -> int | None:
        """Return the time of the next simulated event in µs."""
        if self._firing:
            return self.excitation.due()
        if self._block or self._sweep is not None:
            return max(self.galvo.rests_at, self.laser.rests_at)
        return now if self._queue else None

    def measure(self, point: np.void, shot: int, beam: int = 0) -> PointRecord:
        """Return the A-line that shot ``shot`` of a beam would record at a point, as a reference for tests."""
        dx, dy = self.pattern[beam]
        record = self.recorder.record(int(point["x"]) + dx, int(point["y"]) + dy, self._bias(point), shot, beam)
        return average_shots(0, [replace(record, shot=shot)])

    def _aim(self, now: int) -> None:
        super()._aim(now)
        self._points = [index for index, _ in self._block]

    def _trigger(self, time: int) -> None:
        count = self.excitation.shots()
        self.log.append((self.epoch + time, self._points[self.galvo.step]))
        self.digitiser.trigger(time, count - self._before, count)
        self.laser.free_at = time + self.recorder.length
        self.galvo.trigger(self.laser.free_at)
