"""Simulated record of a shot: a phantom's pressure through the film, with noise and pulse energy.

It is a function of phantom, point, seed and shot number alone, so a test can recompute it: with
``rng = numpy.random.default_rng([seed, shot])`` the pulse energy is ``1 + 0.01·rng.standard_normal()`` and the noise
``rms·rng.standard_normal(N_t, dtype=float32)``, drawn in this order; the noise of beam b > 0
comes from a generator of its own, ``default_rng([seed, shot, b])``: beams share the pulse, not the detector. Sums are
taken in float64 and divided by :attr:`SignalPath.scale`; the mean over a point's shots is rounded and clipped to 16
bits. Points lie on whole nanometres.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fabry_perot.hardware import PlanSampling, TriggerRecord
from fabry_perot.simulator.film import LINEWIDTH, MAX_MODULATION, Film, Response, directivity, low_pass
from fabry_perot.simulator.phantoms import Balls, pressure
from fabry_perot.wire.constants import MISTUNED, SATURATED

REFERENCE_POWER = 1000
"""Nominal interrogation power in µW."""
EXCITATION = 800_000
"""Excitation wavelength to begin with, in pm; the object absorbs in proportion to the wavelength's power −2."""
IDLE_LEVEL = 1_550_000
"""Wavelength of an ideal film, which has no bias of its own, in pm."""
FULL_SCALE = 32767
BLOCK = 16
"""A-lines computed together, ahead of need: a compromise of speed and of how long the simulator is deaf."""
CACHED_POINTS = 16 * 2**20
"""Samples of noise-free Stored A-lines for the next frame (64 MiB); when there are more, all are forgotten."""


class SignalPath:
    """Simulated signal path from phantom and film to digitiser.

    Parameters
    ----------
    balls
        The object.
    sound_speed
        In m/s.
    seed
        Of noise, pulse energies and film.
    noise_db
        Peak signal over rms thermal noise of one shot, in dB.
    response
        The film's shortcomings; none by default.
    energy_jitter
        Standard deviation of the pulse energy, relative.
    full_scale
        The digitiser's range over the strongest signal; below 1 it clips.
    repeat
        Different records made; afterwards they come again. 0: no limit.
    time_zero
        The digitiser begins so long after the pulse, in s; to 100 ps.
    relief
        How the film is uneven, one of :data:`fabry_perot.simulator.film.RESONANCE_PROFILES`.
    """

    def __init__(
        self,
        balls: Balls,
        *,
        sound_speed: float = 1500.0,
        seed: int = 0,
        noise_db: float = 30.0,
        response: Response | None = None,
        energy_jitter: float = 0.01,
        full_scale: float = 2.0,
        repeat: int = 0,
        time_zero: float = 0.0,
        relief: str = "waves",
    ) -> None:
        self._balls, self._sound_speed, self._seed = balls, sound_speed, seed
        self._peak = peak_pressure(balls, sound_speed)
        self.scale = float(np.float32(full_scale * self._peak / FULL_SCALE))
        """Pressure unit per count."""
        self.noise_rms = self._peak * 10 ** (-noise_db / 20)
        self._energy_jitter = energy_jitter
        self.response, self.film = response or Response(), Film(seed, relief)
        self.power, self.excitation = REFERENCE_POWER, EXCITATION
        self._repeat, self._made = repeat, list[TriggerRecord]()
        self._time_zero = round(time_zero * 1e10)
        self._interval = 0.0
        self._times: NDArray[np.float64] = np.zeros(0)
        self.length = 0
        """Of a record, in µs, rounded up."""
        self._lines: dict[tuple[int, int], NDArray[np.float32]] = {}
        self._places: list[tuple[int, int]] = []

    def begin(self, sampling: PlanSampling) -> None:
        """Set record length and sampling interval for a plan."""
        self._interval = sampling.interval_ps * 1e-12
        ticks = np.arange(sampling.samples, dtype=np.float64) * sampling.interval_ps
        self.length = -(-sampling.samples * sampling.interval_ps // 1_000_000)
        self._times = ticks * 1e-12 + self._time_zero * 1e-10
        self._made.clear()
        self._lines.clear()
        self._places.clear()

    def prefetch(self, places: list[tuple[int, int]]) -> None:
        """Register the next points (x, y in nm), so that several are computed together."""
        self._places = places

    def bias(self, x: int, y: int) -> int:
        """Return the film's optimum bias wavelength at a point, in pm."""
        return self.film.bias(x, y) if self.response.nonlinear else IDLE_LEVEL

    def level(self, x: int, y: int, wavelength: int) -> int:
        """Return the DC level of the reflected light in mV."""
        return round(float(self.film.dc_level(x, y, np.array([float(wavelength)]))[0]) * self.power / REFERENCE_POWER)

    def record(self, x: int, y: int, wavelength: int, shot: int, beam: int = 0) -> TriggerRecord:
        """Return the record of shot ``shot`` by beam ``beam`` at x, y (nm), with the laser at ``wavelength`` (pm)."""
        if not self._repeat:
            return self._record(x, y, wavelength, shot, beam)
        if len(self._made) < self._repeat:
            made = self._record(x, y, wavelength, shot, beam)
            self._made.append(replace(made, samples=np.rint(made.samples.astype(np.float64)).astype(np.int16)))
        return replace(self._made[shot % len(self._made)], beam=beam)

    def _record(self, x: int, y: int, wavelength: int, shot: int, beam: int) -> TriggerRecord:
        line = self._line(x, y).astype(np.float64) * (EXCITATION / self.excitation) ** 2
        mistuned = wavelength != self.bias(x, y) and abs(wavelength - self.film.bias(x, y)) > LINEWIDTH / 4
        random = np.random.default_rng([self._seed, shot])
        energy = 1 + self._energy_jitter * random.standard_normal()
        signal = self._signal(line * energy, x, y, wavelength)
        random = np.random.default_rng([self._seed, shot, beam]) if beam else random
        signal += self.noise_rms * random.standard_normal(len(line), dtype=np.float32).astype(np.float64)
        counts = signal / self.scale
        clipped = np.clip(counts, -FULL_SCALE - 1, FULL_SCALE)
        saturated = bool(np.any(np.rint(counts) != np.rint(clipped)))
        level = self.level(x, y, wavelength) if self.response.nonlinear else round(1200 * self.power / REFERENCE_POWER)
        return TriggerRecord(
            samples=clipped,
            scale=self.scale,
            time=0,
            energy=round(1e4 * energy),
            wavelength=wavelength,
            dc=level,
            quality=(SATURATED if saturated else 0) | (MISTUNED if mistuned else 0),
            time_zero=self._time_zero,
            beam=beam,
        )

    def _signal(self, line: NDArray[np.float64], x: int, y: int, wavelength: int) -> NDArray[np.float64]:
        """Return the film's signal for a pressure, in units of the pressure."""
        if not self.response.nonlinear:
            return line
        return self.film.transfer(x, y, wavelength, line * (MAX_MODULATION / self._peak)) * (
            self._peak / MAX_MODULATION
        )

    def _line(self, x: int, y: int) -> NDArray[np.float32]:
        """Return the noise-free A-line of a point, from a cache that is filled in blocks of points."""
        line = self._lines.get((x, y))
        if line is None:
            first = self._places.index((x, y)) if (x, y) in self._places else 0
            ahead = dict.fromkeys([(x, y), *self._places[first : first + BLOCK]])
            places = [place for place in ahead if place not in self._lines][:BLOCK]
            where = np.array(places, dtype=np.float64) * 1e-9
            angular = directivity if self.response.directivity else None
            rows = pressure(self._balls, where, self._times, self._sound_speed, angular)
            if self.response.bandwidth:
                rows = low_pass(rows, self._interval)
            if (len(self._lines) + len(rows)) * len(self._times) > CACHED_POINTS:
                self._lines.clear()
            self._lines.update(zip(places, rows, strict=True))
            line = self._lines[x, y]
        return line


def peak_pressure(balls: Balls, sound_speed: float) -> float:
    """Return the peak |p| over a coarse grid of points on the film, which sets the digitiser's gain."""
    axis = np.linspace(-6e-3, 6e-3, 9)
    where = np.column_stack([grid.ravel() for grid in np.meshgrid(axis, axis)])
    farthest = float(np.linalg.norm(np.abs(balls.centres).max(axis=0) + np.array([6e-3, 6e-3, 0.0])))
    times = np.arange(0, 1.05 * farthest / sound_speed, 8e-9)
    return float(np.abs(pressure(balls, where, times, sound_speed)).max())
