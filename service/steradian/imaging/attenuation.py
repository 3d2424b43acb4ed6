"""Acoustic attenuation by a power law of the frequency, with the dispersion that causality demands.

The complex wave number of a plane wave e^{i(Kx − ωt)} is K(ω) = ω/c(ω) + iα(ω) with α = α₀|ω|^y. Kramers–Kronig
relations, subtracted at ω₀ = 2π·1 MHz, at which the speed of sound is the medium's (K. R. Waters, J. Mobley and
J. G. Miller, IEEE Trans. UFFC 52, 822, 2005):

    1/c(ω) = 1/c₀ + α₀·tan(πy/2)·(|ω|^{y−1} − ω₀^{y−1}),   for y = 1 its limit, −2α₀/π·ln|ω/ω₀|

Continued to complex frequencies, a wave e^{st} falls as e^{−(s/c₀ + Λ)x} with

    Λ(s) = α₀·(s^y/cos(πy/2) − tan(πy/2)·ω₀^{y−1}·s),   for y = 1 its limit, −2α₀/π·s·ln(s/ω₀)
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, log, pi, tan

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.quantity_ranges import ATTENUATION, ATTENUATION_POWER

REFERENCE_FREQUENCY = 1e6
"""Frequency in Hz at which the speed of sound of an attenuating medium is meant."""
_NEPERS = 100 * log(10) / 20  # nepers a metre in a decibel a centimetre


@dataclass(frozen=True, slots=True)
class Attenuation:
    """Power law of acoustic attenuation: ``coefficient``·(f/MHz)^``power`` dB/cm.

    Parameters
    ----------
    coefficient
        In dB/(MHz^y cm), 0 to 100.
    power
        y, 0 to 2.9: towards 3 the dispersion relation needs another constant. Tissue has 1 to 1.5, water 2.

    Raises
    ------
    InvalidInput
        If a value is out of range.
    """

    coefficient: float
    power: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficient", ATTENUATION.check("coefficient", self.coefficient))
        object.__setattr__(self, "power", ATTENUATION_POWER.check("power", self.power))

    def absorption(self, frequencies: ArrayLike) -> NDArray[np.float64]:
        """Return α in Np/m at frequencies in Hz, of any shape."""
        f = np.abs(np.asarray(frequencies, np.float64)) / 1e6
        return np.asarray(self.coefficient * _NEPERS * f**self.power)

    def decay(self, s: ArrayLike) -> NDArray[np.complex128]:
        """Return Λ in 1/m at complex frequencies s in 1/s with positive imaginary parts, of any shape."""
        s = np.asarray(s, np.complex128)
        y, omega = self.power, 2 * pi * REFERENCE_FREQUENCY
        if abs(y - 1) < 1e-6:  # pole and zero cancel
            shape = -2 / pi * s / omega * np.log(s / omega)
        else:
            shape = (s / omega) ** y / cos(pi * y / 2) - tan(pi * y / 2) * s / omega
        return np.asarray(float(self.absorption(REFERENCE_FREQUENCY)) * shape)

    def excess(self, frequencies: ArrayLike) -> NDArray[np.complex128]:
        """Return K − ω/c₀ in 1/m at frequencies above 0 in Hz, of any shape: dispersion, and i times absorption."""
        return np.asarray(1j * np.conj(self.decay(2j * pi * np.asarray(frequencies, np.float64))))

    def __str__(self) -> str:
        return f"{self.coefficient:g} dB/(MHz^{self.power:g} cm)"


ATTENUATIONS = {
    "water": Attenuation(2.17e-3, 2.0),
    "soft tissue": Attenuation(0.75, 1.5),
}
"""Attenuations by name: water at 20 °C (25·10⁻¹⁵ Np s²/m, J. M. M. Pinkerton, Proc. Phys. Soc. B 62, 129, 1949), and
soft tissue, which is breast (T. L. Szabo, Diagnostic Ultrasound Imaging, 2004, appendix B)."""
