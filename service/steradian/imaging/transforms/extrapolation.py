"""Wavefield extrapolation in time through plane layers (phase shift, J. Gazdag 1978, with complex frequencies).

A field that a plane hears from the laser pulse on, of sound that goes up, is known in all layers above it. In the
Laplace transform over time, s = ε + iω, and the Fourier transform over the plane that is one factor for each s and k:

    H(s, k) = Π T_i · e^{−Σ γ_i d_i},   γ_i = √((s/c_i + Λ_i)² + |k|²),   T_i = 2ρ_i γ_{i+1}/(ρ_i γ_{i+1} + ρ_{i+1} γ_i)

with the pressure's transmission T_i from layer i + 1 up to layer i, and a layer's attenuation Λ_i(s)
(:mod:`steradian.imaging.attenuation`). Evanescent waves decay, as γ is real there. The
damping ε keeps γ off its branch points, and what a finite transform folds back from beyond its end is e^{−εP} times as
strong, for P samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, log

import numpy as np
from numpy.typing import NDArray

from steradian.imaging.medium import LayerPath
from steradian.imaging.transforms.grid_sizes import fast_size

Floats = NDArray[np.float64]
LENGTH = 1.5
"""Samples of the transform to those from the pulse to the record's end."""
FOLDED = 1e-4
"""Share e^{−εP} of folded sound. Its inverse amplifies rounding."""
FLAT = 0.9
"""Share of the Nyquist frequency up to which the extrapolation is exact."""
EQUAL_DENSITY = 1000.0
"""Density of all layers in kg/m³ where none is given; only ratios count."""


@dataclass(frozen=True, slots=True, eq=False)
class Extrapolation:
    """Extrapolation of a plane's field to the film, as a linear map over time for each lateral wavenumber.

    Parameters
    ----------
    source
        Samples of the field at the plane, the first one at the pulse.
    samples, interval
        Samples at the film, and seconds between samples, of both.
    first, fraction
        The film's first sample is at (``first`` + ``fraction``)·``interval`` after the pulse, 0 ≤ fraction < 1.
    length, damping
        P, and ε·``interval``.
    path
        (2, L) lengths in m and densities in kg/m³ of the layers from the film to that of the plane.
    slowness
        (L, P//2 + 1) s/c_i + Λ_i(s) in 1/m of these layers.
    """

    source: int
    samples: int
    interval: float
    first: int
    fraction: float
    length: int
    damping: float
    path: Floats
    slowness: NDArray[np.complex128]

    @property
    def taper(self) -> Floats:
        """Real factors of the frequencies: 1, and from :data:`FLAT` of the Nyquist frequency on down to 0 at it.

        A field that begins with a jump, of what lies on a boundary, would ring on and on otherwise.
        """
        share = np.arange(self.length // 2 + 1) * (2 / self.length)
        found: Floats = np.cos(0.5 * np.pi * np.clip((share - FLAT) / (1 - FLAT), 0, 1)) ** 2
        return found

    @property
    def shift(self) -> NDArray[np.complex128]:
        """Factors of the frequencies that take samples to the film's times: taper, and the fraction of a sample."""
        turns = np.arange(self.length // 2 + 1) * (self.fraction / self.length)
        return np.asarray(self.taper * np.exp(2j * np.pi * turns))

    @property
    def decay(self) -> Floats:
        """Factors e^{−εt} of the plane's samples, shape (``source``,); half at the pulse, where the field begins."""
        found: Floats = np.exp(-self.damping * np.arange(self.source))
        found[0] *= 0.5
        return found

    @property
    def growth(self) -> Floats:
        """Factors e^{εt} of the film's samples, shape (``samples``,)."""
        found: Floats = np.exp(self.damping * (self.first + self.fraction + np.arange(self.samples)))
        return found


def plan_extrapolation(
    path: LayerPath, gap: float, *, source: int, samples: int, interval: float, time_zero: float
) -> Extrapolation:
    """Return the extrapolation from a plane ``gap`` metres below a layer's upper boundary to the film.

    Parameters
    ----------
    path
        Layers from the film to that of the plane.
    gap
        In m.
    source, samples, interval
        As in :class:`Extrapolation`.
    time_zero
        Time of the film's first sample after the pulse, in s.
    """
    begins = round(time_zero / interval, 9)
    first = floor(begins)
    length = fast_size(LENGTH * max(source, first + samples))
    damping = -log(FOLDED) / length
    s = (damping + 2j * np.pi * np.arange(length // 2 + 1) / length) / interval
    slowness = [
        s / each.sound_speed + (0 if each.attenuation is None else each.attenuation.decay(s)) for each in path.layers
    ]
    table = np.array([(each.thickness or 0.0, each.density or EQUAL_DENSITY) for each in path.layers]).T
    table[0, -1] = gap
    return Extrapolation(
        source, samples, interval, first, begins - first, length, damping, np.ascontiguousarray(table),
        np.array(slowness),
    )  # fmt: skip
