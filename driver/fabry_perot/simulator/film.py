"""Simulated Fabry–Pérot film: resonance over position, and conversion of pressure into a signal.

The reflected DC level is a Lorentzian dip, ``R₀·(1 − V/(1 + ((λ − λ₀)/½w)²))``, whose resonance λ₀ and level R₀ vary
over the film. Sound changes the cavity's thickness and so moves λ₀; the signal is the change of the level, which is
proportional to the pressure only while that move is small against the linewidth w.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LINEWIDTH = 500.0
"""Full width at half maximum of the fringe, in pm."""
VISIBILITY = 0.6
CENTRE, SPREAD = 1_550_000.0, 2_000.0
"""Resonance: mean and largest deviation over the film, in pm."""
LEVEL = 1200.0
"""DC level off resonance at nominal interrogation power, in mV."""
BANDWIDTH = 22e6
"""−3 dB frequency of the film, in Hz."""
CRITICAL = 0.85
"""Sine of the angle beyond which the film hardly sees sound."""
MAX_MODULATION = 0.15
"""The strongest signal moves the resonance by this share of half the linewidth."""


@dataclass(frozen=True, slots=True)
class Response:
    """Selection of the film's simulated imperfections.

    Parameters
    ----------
    nonlinear
        The fringe's curvature, and a loss of sensitivity away from the bias wavelength.
    bandwidth
        The film's low-pass.
    directivity
        Less response to sound that comes from the side.
    """

    nonlinear: bool = False
    bandwidth: bool = False
    directivity: bool = False

    def __str__(self) -> str:
        """Return the names of the imperfections, for example "bandwidth, directivity", or "ideal"."""
        return ", ".join(name for name in ("nonlinear", "bandwidth", "directivity") if getattr(self, name)) or "ideal"


RESONANCE_PROFILES = ("waves", "scatter", "wedge", "domains", "both")
"""How the resonance varies over a film: smoothly up and down; from point to point; steadily from one side to the other;
in patches with a resonance each; a wedge with such patches."""
NOISE_SCALE = 20_000
"""Size in nm of the patches of a film that scatters."""
PATCH_COUNT = 40
"""Patches of a film in domains."""
HALF_WIDTH = 7e6
"""Half of a film's side in nm; a wedge spreads over it."""


class Film:
    """Simulated Fabry–Pérot film with a resonance wavelength that varies over its area.

    Parameters
    ----------
    seed
        Of its unevenness.
    relief
        One of :data:`RESONANCE_PROFILES`.
    """

    def __init__(self, seed: int, relief: str = "waves") -> None:
        self._seed, self._relief = seed, relief
        patches = np.random.default_rng([seed, 17])
        self._places = patches.uniform(-HALF_WIDTH, HALF_WIDTH, (PATCH_COUNT, 2))
        self._shifts = patches.uniform(-1, 1, PATCH_COUNT)
        random = np.random.default_rng([seed, 7])
        self._waves = random.normal(size=(2, 6, 2)) * 500.0
        self._phases = random.uniform(0, 2 * np.pi, (2, 6))
        self.drift = 0
        """Shift of all resonances since the film was made, in pm: films drift with temperature."""

    def _uneven(self, kind: int, x: int, y: int) -> float:
        angles = self._waves[kind] @ np.array([x, y]) * 1e-9 + self._phases[kind]
        return float(np.tanh(np.sin(angles).sum() / 2))

    def resonance(self, x: int, y: int) -> float:
        """Return the resonance wavelength in pm at x, y in nm."""
        return CENTRE + SPREAD * self._relative(x, y) + self.drift

    def _relative(self, x: int, y: int) -> float:
        """Return the resonance's relative deviation (−1 … 1) at a point, by the selected profile."""
        match self._relief:
            case "scatter":
                cell = [x // NOISE_SCALE + (1 << 31), y // NOISE_SCALE + (1 << 31)]
                return float(np.random.default_rng([self._seed, 13, *cell]).uniform(-1, 1))
            case "wedge":
                return float(np.clip((0.8 * x + 0.6 * y) / HALF_WIDTH, -1, 1))
            case "domains":
                return float(self._shifts[np.argmin(np.hypot(*(self._places - [x, y]).T))])
            case "both":
                patch = float(self._shifts[np.argmin(np.hypot(*(self._places - [x, y]).T))])
                return float(np.clip((0.8 * x + 0.6 * y) / HALF_WIDTH, -1, 1)) / 2 + patch / 2
            case _:
                return self._uneven(0, x, y)

    def bias(self, x: int, y: int) -> int:
        """Return the optimum bias wavelength (steepest slope of the resonance) in pm."""
        return round(self.resonance(x, y) + LINEWIDTH / (2 * math.sqrt(3)))

    def dc_level(self, x: int, y: int, wavelengths: Array) -> Array:
        """Return the DC level in mV at wavelengths (S,) in pm."""
        detuning = (wavelengths - self.resonance(x, y)) / (LINEWIDTH / 2)
        level: Array = LEVEL * (1 + 0.1 * self._uneven(1, x, y)) * (1 - VISIBILITY / (1 + detuning**2))
        return level

    def transfer(self, x: int, y: int, wavelength: int, swing: Array) -> Array:
        """Return the signal for resonance shifts ``swing`` (half linewidths), relative to the best bias."""
        detuning = (wavelength - self.resonance(x, y)) / (LINEWIDTH / 2)
        steepest = 3 * np.sqrt(3) / 8  # of 1/(1 + u²), at u = 1/√3
        signal: Array = (1 / (1 + detuning**2) - 1 / (1 + (detuning + swing) ** 2)) / steepest
        return signal


def low_pass(rows: NDArray[np.float32], interval: float) -> NDArray[np.float32]:
    """Apply the film's one-pole low-pass filter to rows (M, N_t); ``interval`` in s."""
    count = rows.shape[1]
    frequency = np.fft.rfftfreq(2 * count, interval)
    spectrum = np.fft.rfft(rows, 2 * count, axis=1) / (1 + 1j * frequency / BANDWIDTH)
    filtered: NDArray[np.float32] = np.fft.irfft(spectrum, axis=1)[:, :count].astype(np.float32)
    return filtered


def directivity(cosines: Array) -> Array:
    """Return the film's response by cosine of the angle of incidence: flat, then zero at the critical angle."""
    sine2 = 1 - np.minimum(cosines, 1.0) ** 2
    response: Array = 1 / (1 + (sine2 / CRITICAL**2) ** 4)
    return response
