"""The simulated hardware: galvo, pulsed laser, Fabry–Pérot film over a phantom, digitiser.

What a shot records is a function of phantom, point, seed and shot number alone, so a test can recompute it: with
``rng = numpy.random.default_rng([seed, shot])`` the pulse energy is ``1 + 0.01·rng.standard_normal()`` and the noise
``rms·rng.standard_normal(N_t, dtype=float32)``, drawn in this order; sums are taken in float64, divided by the number
of averages and by :attr:`PhantomInstrument.scale`, rounded and clipped to 16 bits. Points lie on whole nanometres.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabry_perot.codes import SATURATED
from fabry_perot.instrument import Acquisition, Recording
from fabry_perot.messages import POINT
from fabry_perot.phantoms import Balls, pressure
from fabry_perot.simulator.motion import Galvo, PulseTrain

ENERGY_JITTER = 0.01
"""Standard deviation of the pulse energy, relative."""
FULL_SCALE = 32767
HALF_APERTURE = 10_000_000
"""Reach of the galvo to either side, in nm."""
BLOCK = 16
"""A-lines computed together, ahead of need: a compromise of speed and of how long the simulator is deaf."""


class PhantomInstrument:
    """Simulated hardware over a phantom.

    Parameters
    ----------
    balls
        The object.
    sound_speed
        In m/s.
    seed
        Of noise and pulse energies.
    noise_db
        Peak signal over rms noise of one shot, in dB.
    clock_rate
        Device seconds per host second, as told to the host.
    line_rate
        Bytes per device second the line carries, as told to the host; 0 for unlimited.
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
    ) -> None:
        self._balls, self._sound_speed, self._seed = balls, sound_speed, seed
        peak = peak_pressure(balls, sound_speed)
        self.scale = float(np.float32(2 * peak / FULL_SCALE))
        """Pressure unit per count: the strongest signal uses half the range."""
        self.noise_rms = peak * 10 ** (-noise_db / 20)
        self._clock_rate, self._line_rate = clock_rate, line_rate
        self._galvo, self._laser = Galvo(), PulseTrain(seed)
        self._acquisition = Acquisition(0, 0, 0)
        self._times: NDArray[np.float64] = np.zeros(0)
        self._points: NDArray[np.void] = np.zeros(0, POINT)
        self._lines: dict[int, NDArray[np.float32]] = {}
        self._shots: list[int] = []

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
            "wavelength_pm": [1_500_000, 1_600_000],
            "adc_bits": 16,
            "beams": 1,
            "encodings": [0],
            "clock_rate": self._clock_rate,
            "line_rate": self._line_rate,
        }

    def begin(self, acquisition: Acquisition) -> None:
        """Set up for a plan."""
        self._acquisition = acquisition
        self._times = np.arange(acquisition.samples, dtype=np.float64) * (acquisition.interval_ps * 1e-12)
        self._laser.rate(acquisition.pulse_rate_mhz)
        self._points = np.zeros(0, POINT)
        self._lines.clear()
        self._shots.clear()

    def load(self, first: int, points: NDArray[np.void]) -> None:
        """Learn the points from index ``first``."""
        if first != len(self._points):
            raise ValueError(f"points from {first} after {len(self._points)}")
        self._points = np.concatenate([self._points, points])

    def move(self, index: int, now: int) -> int:
        """Start to move and return when the galvo will have settled, in µs."""
        point = self._points[index]
        return self._galvo.move(int(point["x"]), int(point["y"]), now)

    def next_pulse(self, after: int) -> int:
        """Return the laser's first pulse at or after ``after``, in µs."""
        return self._laser.next_pulse(after)

    def fire(self, index: int, shot: int, now: int) -> None:
        """Fire one shot."""
        self._shots.append(shot)

    def drop(self) -> None:
        """Forget the shots of an unfinished point."""
        self._shots.clear()

    def read(self, index: int) -> Recording:
        """Return the mean of the shots fired since the last read, digitised."""
        line = self._line(index).astype(np.float64)
        total = np.zeros(len(line))
        energies = 0.0
        for shot in self._shots:
            random = np.random.default_rng([self._seed, shot])
            energy = 1 + ENERGY_JITTER * random.standard_normal()
            total += line * energy
            total += self.noise_rms * random.standard_normal(len(line), dtype=np.float32).astype(np.float64)
            energies += energy
        count = len(self._shots)
        self._shots.clear()
        counts = np.rint(total / (count * self.scale))
        clipped = np.clip(counts, -FULL_SCALE - 1, FULL_SCALE)
        return Recording(
            samples=clipped.astype(np.int16),
            scale=self.scale,
            energy=round(1e4 * energies / count),
            wavelength=int(self._points[index]["wavelength"]) or 1_550_000,
            dc=1200,
            quality=SATURATED if np.any(counts != clipped) else 0,
        )

    def _line(self, index: int) -> NDArray[np.float32]:
        """Return the noise-free A-line of a point; computes a block ahead and forgets what lies behind."""
        line = self._lines.get(index)
        if line is None:
            block = self._points[index : index + BLOCK]
            where = np.column_stack([block["x"], block["y"]]) * 1e-9
            rows = pressure(self._balls, where, self._times, self._sound_speed)
            self._lines = dict(enumerate(rows, start=index))
            line = self._lines[index]
        return line

    def park(self) -> None:
        """Close the shutter: the galvo stays where it is."""

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
