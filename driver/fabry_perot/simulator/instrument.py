"""The simulated hardware: galvo, pulsed laser, Fabry–Pérot film over a phantom, digitiser.

What a shot records is a function of phantom, point, seed and shot number alone, so a test can recompute it: with
``rng = numpy.random.default_rng([seed, shot])`` the pulse energy is ``1 + 0.01·rng.standard_normal()`` and the noise
``rms·rng.standard_normal(N_t, dtype=float32)``, drawn in this order; sums are taken in float64, divided by the number
of averages and by :attr:`PhantomInstrument.scale`, rounded and clipped to 16 bits. Points lie on whole nanometres.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabry_perot.hardware.instrument import Interrogation, Sampling
from fabry_perot.simulator.film import LINEWIDTH, SWING, Film, Response, directivity, low_pass
from fabry_perot.simulator.motion import Galvo, PulseTrain
from fabry_perot.simulator.phantoms import Balls, pressure
from fabry_perot.wire.codes import MISTUNED, SATURATED
from fabry_perot.wire.messages import POINT

POWER = 1000
"""Nominal interrogation power in µW."""
EXCITATION = 800_000
"""Excitation wavelength to begin with, in pm; the object absorbs in proportion to the wavelength's power −2."""
TUNING_STEP = 200
"""Time of one step of a wavelength sweep, in µs."""
LOG = 200_000
"""Shots remembered."""
FULL_SCALE = 32767
HALF_APERTURE = 10_000_000
"""Reach of the galvo to either side, in nm."""
BLOCK = 16
"""A-lines computed together, ahead of need: a compromise of speed and of how long the simulator is deaf."""


class PhantomInstrument:
    """Simulated hardware over a phantom.

    By default the film is ideal: A-lines are the phantom's closed-form pressure plus noise. ``response`` makes it real.

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
    clock_rate
        Device seconds per host second, as told to the host.
    line_rate
        Bytes per device second the line carries, as told to the host; 0 for unlimited.
    response
        The film's shortcomings; none by default.
    energy_jitter
        Standard deviation of the pulse energy, relative.
    full_scale
        The digitiser's range over the strongest signal; below 1 it clips.
    repeat
        Different recordings made; afterwards they come again. 0: no limit.
    time_zero
        The digitiser begins so long after the pulse, in s; to 100 ps.
    """

    def __init__(
        self,
        balls: Balls,
        *,
        sound_speed: float = 1500.0,
        seed: int = 0,
        noise_db: float = 30.0,
        clock_rate: float = 1.0,
        line_rate: int = 0,
        response: Response | None = None,
        energy_jitter: float = 0.01,
        full_scale: float = 2.0,
        repeat: int = 0,
        time_zero: float = 0.0,
    ) -> None:
        self._balls, self._sound_speed, self._seed = balls, sound_speed, seed
        self._peak = peak_pressure(balls, sound_speed)
        self.scale = float(np.float32(full_scale * self._peak / FULL_SCALE))
        """Pressure unit per count."""
        self.noise_rms = self._peak * 10 ** (-noise_db / 20)
        self._clock_rate, self._line_rate, self._energy_jitter = clock_rate, line_rate, energy_jitter
        self.response, self.film = response or Response(), Film(seed)
        self.closed = True
        """Whether the interlock is closed."""
        self.key = True
        """Whether the key is on."""
        self._open = False
        self.epoch = 0
        """Simulator time at which the device booted, in µs."""
        self.shots: deque[tuple[int, int]] = deque(maxlen=LOG)
        """Simulator time (µs) and point of the last shots: the truth that no reboot and no line can change."""
        self._fired = 0
        self._power, self._excitation = POWER, EXCITATION
        self._repeat, self._recordings = repeat, list[Interrogation]()
        self._time_zero = round(time_zero * 1e10)
        self._galvo, self._laser = Galvo(), PulseTrain(seed)
        self._sampling = Sampling(0, 0, 0)
        self._times: NDArray[np.float64] = np.zeros(0)
        self._points: NDArray[np.void] = np.zeros(0, POINT)
        self._first = 0
        self._lines: dict[int, NDArray[np.float32]] = {}
        self._numbers: list[int] = []

    def capabilities(self) -> dict[str, Any]:
        """Return the limits."""
        return {
            "model": "simulated Fabry-Perot scanner",
            "serial": f"SIM-{self._seed:04d}",
            "simulated": True,
            "x_nm": [-HALF_APERTURE, HALF_APERTURE],
            "y_nm": [-HALF_APERTURE, HALF_APERTURE],
            "samples": [16, 16384],
            "interval_ps": [1_000, 1_000_000],
            "pulse_rate_mhz": [1_000, 10_000_000],
            "averages": [1, 1000],
            "wavelength_pm": [1_545_000, 1_555_000],
            "adc_bits": 16,
            "beams": 1,
            "encodings": [0, 1],
            "clock_rate": self._clock_rate,
            "line_rate": self._line_rate,
            "tuning_us": TUNING_STEP,
            "parameters": {"interrogation_uw": [100, 5000], "excitation_pm": [400_000, 2_000_000]},
        }

    def begin(self, sampling: Sampling) -> None:
        """Set up for a plan."""
        self._sampling = sampling
        ticks = np.arange(sampling.samples, dtype=np.float64) * sampling.interval_ps
        self._times = ticks * 1e-12 + self._time_zero * 1e-10
        self._laser.rate(sampling.pulse_rate_mhz)
        self._points = np.zeros(0, POINT)
        self._recordings.clear()
        self._lines.clear()
        self._numbers.clear()

    def load(self, first: int, points: NDArray[np.void]) -> None:
        """Learn the points from index ``first``."""
        if len(self._points) == 0:
            self._first = first
        if first != self._first + len(self._points):
            raise ValueError(f"points from {first} after {self._first + len(self._points)}")
        self._points = np.concatenate([self._points, points])

    def _point(self, index: int) -> np.void:
        point: np.void = self._points[index - self._first]
        return point

    def move(self, index: int, now: int) -> int:
        """Start to move and return when the galvo will have settled, in µs."""
        point = self._point(index)
        return self._galvo.move(int(point["x"]), int(point["y"]), now)

    def next_pulse(self, after: int) -> int:
        """Return the laser's first pulse at or after ``after``, in µs."""
        return self._laser.next_pulse(after)

    def fire(self, index: int, shot: int, now: int) -> None:
        """Fire one shot."""
        self._fired += 1
        self.shots.append((self.epoch + now, index))
        self._numbers.append(shot)

    def laser_shots(self) -> int:
        """Return the shots fired since the simulator started."""
        return self._fired

    def drop(self) -> None:
        """Forget the shots of an unfinished point."""
        self._numbers.clear()

    def read(self, index: int) -> Interrogation:
        """Return the mean of the shots fired since the last read, digitised."""
        if not self._repeat:
            return self._record(index)
        if len(self._recordings) < self._repeat:
            self._recordings.append(self._record(index))
        self._numbers.clear()
        return self._recordings[index % len(self._recordings)]

    def _record(self, index: int) -> Interrogation:
        line = self._line(index).astype(np.float64) * (EXCITATION / self._excitation) ** 2
        point = self._point(index)
        x, y, wavelength = int(point["x"]), int(point["y"]), int(point["wavelength"])
        bias = self.film.bias(x, y)
        mistuned = bool(wavelength) and abs(wavelength - bias) > LINEWIDTH / 4
        used = wavelength or (bias if self.response.nonlinear else 1_550_000)
        total, energies = np.zeros(len(line)), 0.0
        for shot in self._numbers:
            random = np.random.default_rng([self._seed, shot])
            energy = 1 + self._energy_jitter * random.standard_normal()
            total += self._signal(line * energy, x, y, used)
            total += self.noise_rms * random.standard_normal(len(line), dtype=np.float32).astype(np.float64)
            energies += energy
        count = len(self._numbers)
        self._numbers.clear()
        counts = np.rint(total / (count * self.scale))
        clipped = np.clip(counts, -FULL_SCALE - 1, FULL_SCALE)
        level = self.film.level(x, y, np.array([float(used)]))[0] if self.response.nonlinear else 1200
        return Interrogation(
            samples=clipped.astype(np.int16),
            scale=self.scale,
            energy=round(1e4 * energies / count),
            wavelength=used,
            dc=round(level * self._power / POWER),
            quality=(SATURATED if np.any(counts != clipped) else 0) | (MISTUNED if mistuned else 0),
            time_zero=self._time_zero,
        )

    def _signal(self, line: NDArray[np.float64], x: int, y: int, wavelength: int) -> NDArray[np.float64]:
        """Return what the film makes of a pressure, in the pressure's unit."""
        if not self.response.nonlinear:
            return line
        return self.film.transfer(x, y, wavelength, line * (SWING / self._peak)) * (self._peak / SWING)

    def _line(self, index: int) -> NDArray[np.float32]:
        """Return the noise-free A-line of a point; computes a block ahead and forgets what lies behind."""
        line = self._lines.get(index)
        if line is None:
            first = index - self._first
            block = self._points[first : first + BLOCK]
            where = np.column_stack([block["x"], block["y"]]) * 1e-9
            angular = directivity if self.response.directivity else None
            rows = pressure(self._balls, where, self._times, self._sound_speed, angular)
            if self.response.bandwidth:
                rows = low_pass(rows, self._sampling.interval_ps * 1e-12)
            self._lines = dict(enumerate(rows, start=index))
            line = self._lines[index]
        return line

    def tune(self, x: int, y: int, wavelengths: NDArray[np.int64], now: int) -> tuple[list[int], int]:
        """Sweep the interrogation wavelength at a point: DC levels in mV, and when the sweep ends."""
        settled = self._galvo.move(x, y, now)
        levels = self.film.level(x, y, wavelengths.astype(np.float64)) * (self._power / POWER)
        return [round(level) for level in levels.tolist()], settled + TUNING_STEP * len(levels)

    def parameters(self) -> dict[str, int]:
        """Return what SET changes."""
        return {"interrogation_uw": self._power, "excitation_pm": self._excitation}

    def configure(self, name: str, value: int) -> None:
        """Change the interrogation power or tune the excitation laser."""
        if name == "excitation_pm":
            self._excitation = value
        else:
            self._power = value

    def interlock_closed(self) -> bool:
        """Return whether the interlock is closed."""
        return self.closed

    def key_on(self) -> bool:
        """Return whether the key is on."""
        return self.key

    def open(self) -> None:
        """Open the shutter."""
        self._open = True

    def close(self) -> None:
        """Close the shutter."""
        self._open = False

    def shutter_open(self) -> bool:
        """Return whether the shutter is open."""
        return self._open

    def emitting(self) -> bool:
        """Return whether pulses may leave the aperture."""
        return self._open and self.key and self.closed

    def park(self) -> None:
        """Do nothing: the galvo rests where it is."""

    def position(self) -> tuple[int, int]:
        """Return x, y in nm."""
        return self._galvo.x, self._galvo.y


def peak_pressure(balls: Balls, sound_speed: float) -> float:
    """Return the strongest |p| over a coarse grid of points on the film, which sets the digitiser's gain."""
    axis = np.linspace(-6e-3, 6e-3, 9)
    where = np.column_stack([grid.ravel() for grid in np.meshgrid(axis, axis)])
    farthest = float(np.linalg.norm(np.abs(balls.centres).max(axis=0) + np.array([6e-3, 6e-3, 0.0])))
    times = np.arange(0, 1.05 * farthest / sound_speed, 8e-9)
    return float(np.abs(pressure(balls, where, times, sound_speed)).max())
