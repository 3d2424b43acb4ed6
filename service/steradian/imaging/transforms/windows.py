"""Window functions of the NUFFT: shape, Fourier transform, error, polynomial of each tap.

A window φ lives on |x| ≤ w/2 in units of the oversampled grid. Its transform ψ(ξ) = ∫ φ(x) cos(2πξx) dx, ξ in cycles
per grid cell, is divided out. Paper section 3: φ is Ψ-hat, ψ is Ψ, w = 2K, and the oversampling is c.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from steradian.core.quantity_ranges import QuantityRange, as_finite_float
from steradian.imaging.validation import check_choice, check_integer

Shape: TypeAlias = Literal["semicircle", "kaiser-bessel"]
MAX_TAPS = 48
"""Both ends of a spectrum are repeated that far, half of it at either."""
OVERSAMPLING = QuantityRange(1, 16, "grid points per mode", above=True)
STEEPNESS = QuantityRange(0, 500, "β", above=True)


@dataclass(frozen=True, slots=True)
class Window:
    """NUFFT window function of ``width`` taps for grids oversampled at least ``oversampling`` times.

    Parameters
    ----------
    shape
        "semicircle": exp(β·(√(1−(2x/w)²) − 1)); "kaiser-bessel": the paper's, taps sinh(β√(1−(2x/w)²))/√(1−(2x/w)²).
    width
        Number of taps w (the paper's 2K).
    oversampling
        Grid points per mode, σ (the paper's c), more than 1: the spectrum's copies must not meet.
    beta
        Steepness β, more than 0.

    Raises
    ------
    InvalidInput
        If a number is out of range.
    """

    shape: Shape
    width: int
    oversampling: float
    beta: float

    def __post_init__(self) -> None:
        check_choice("shape", self.shape, get_args(Shape))
        check_integer("width", self.width, 2, MAX_TAPS)
        OVERSAMPLING.check("oversampling", self.oversampling)
        STEEPNESS.check("beta", self.beta)

    def __call__(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the window's value φ(x), x in grid cells, any shape; zero beyond half the width."""
        inside = 1.0 - (2.0 * np.asarray(x, np.float64) / self.width) ** 2
        root = np.sqrt(np.maximum(inside, 0.0))
        if self.shape == "semicircle":
            value = np.exp(self.beta * (root - 1.0))
        else:
            safe = np.maximum(root, 1e-12)
            value = np.where(root > 1e-9, np.sinh(self.beta * safe) / safe, self.beta) / np.sinh(self.beta)
        return np.where(inside >= 0.0, value, 0.0)

    def transform(self, xi: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the window's Fourier transform ψ(ξ), ξ in cycles per grid cell, by Gauss-Legendre quadrature."""
        angle, weights = _quadrature(8 * self.width + 32)
        # x = w/2·sin(πs/2) takes the square root's edge away
        x = self.width / 2 * np.sin(angle)
        values = self(x) * weights * np.cos(angle) * (np.pi / 2) * self.width / 2
        flat = np.ravel(np.asarray(xi, np.float64))
        result = np.cos(2 * np.pi * flat[:, None] * x[None, :]) @ values
        return result.reshape(np.shape(xi))

    def taps(self, fraction: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the window's values at the w grid points around each position: (…, w) for fractions in [0, 1).

        The first grid point is ⌊u − w/2⌋ + 1 and the fraction that of u − w/2.
        """
        return self(self._distances(fraction))

    def tap_slopes(self, fraction: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the derivatives of :meth:`taps` by the position in grid cells, (…, w)."""
        return -self.slope(self._distances(fraction))

    def _distances(self, fraction: NDArray[np.float64]) -> NDArray[np.float64]:
        steps = np.arange(self.width) + 1.0 - self.width / 2
        return np.asarray(steps - np.asarray(fraction, np.float64)[..., None])

    def slope(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the window's derivative φ′(x) per grid cell, x in grid cells, any shape; zero beyond half the width.

        For "semicircle" it grows without bound towards the window's ends.
        """
        inside = 1.0 - (2.0 * np.asarray(x, np.float64) / self.width) ** 2
        root = np.sqrt(np.maximum(inside, 1e-12))
        inner = -4.0 * np.asarray(x, np.float64) / self.width**2  # root·root′
        if self.shape == "semicircle":
            value = np.exp(self.beta * (root - 1.0)) * self.beta * inner / root
        else:
            b = self.beta * root
            near = np.where(b < 1e-2, 1.0, b)
            curve = np.where(b < 1e-2, 1 / 3 + b**2 / 30, (np.cosh(near) * near - np.sinh(near)) / near**3)
            value = self.beta**3 * curve * inner / np.sinh(self.beta)
        return np.where(inside >= 0.0, value, 0.0)

    def error(self) -> float:
        """Return the RMS relative error of a 1-D NUFFT over the modes |ξ| ≤ 1/(2σ) and all fractions."""
        xi = (np.arange(48) + 0.5) / 48 / (2 * self.oversampling)
        fraction = (np.arange(16) + 0.5) / 16
        steps = np.arange(self.width) + 1.0 - self.width / 2
        distance = steps[None, :] - fraction[:, None]
        phase = np.exp(2j * np.pi * xi[:, None, None] * distance[None])
        sums = np.einsum("ft,xft->xf", self(distance), phase)
        relative = np.abs(sums / self.transform(xi)[:, None] - 1.0)
        return float(np.sqrt(np.mean(relative**2)))

    def polynomials(self, accuracy: float) -> NDArray[np.float64]:
        """Return polynomial coefficients (w, D+1), lowest power first, of each tap in y = 2·fraction − 1 ∈ [−1, 1].

        The degree D is the smallest with which the taps differ by less than ``accuracy`` of the window's peak.
        """
        y = np.cos(np.pi * (np.arange(256) + 0.5) / 256)
        exact = self.taps((y + 1) / 2)
        for degree in range(2, 24):
            fitted = np.polynomial.chebyshev.chebfit(y, exact, degree)
            if np.abs(np.polynomial.chebyshev.chebval(y, fitted).T - exact).max() < accuracy or degree == 23:
                break
        powers = np.zeros((self.width, degree + 1))
        for tap, series in zip(powers, fitted.T, strict=True):
            found = np.polynomial.chebyshev.cheb2poly(series)  # shorter where the last coefficients are 0
            tap[: len(found)] = found
        return powers


@lru_cache(maxsize=MAX_TAPS)
def _quadrature(count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the angles π/2·s and the weights of Gauss-Legendre quadrature; the search of a window takes them often."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    angle = np.pi / 2 * nodes
    angle.flags.writeable = weights.flags.writeable = False
    return angle, weights


@lru_cache(maxsize=256)
def kaiser_bessel(half_width: float, oversampling: float) -> Window:
    """Return the paper's Kaiser-Bessel window: K taps a side, oversampling c, α = π(2c − 1) (section 3).

    Raises
    ------
    InvalidInput
        If 2K is not 2 to 48, or c is not above 1.
    """
    width = round(2 * as_finite_float("half_width", half_width, f"a number of taps to {MAX_TAPS // 2}"))
    OVERSAMPLING.check("oversampling", oversampling)
    beta = np.pi * (2.0 - 1.0 / oversampling) * half_width
    return Window("kaiser-bessel", width, oversampling, float(beta))


@lru_cache(maxsize=256)
def semicircle(width: int, oversampling: float) -> Window:
    """Return the exponential-of-semicircle window with the steepness of least mean error."""
    base = np.pi * width * (1.0 - 0.5 / oversampling)
    candidates = [Window("semicircle", width, oversampling, float(base * f)) for f in np.linspace(0.9, 1.0, 11)]
    return min(candidates, key=Window.error)


@lru_cache(maxsize=256)
def narrowest_window(shape: Shape, tolerance: float, oversampling: float) -> Window | None:
    """Return the narrowest window of a shape with a 1-D error below ``tolerance``; None if there is none.

    With little oversampling and twenty taps there is none below 1e-11.
    """
    for width in range(3, 21):
        window = kaiser_bessel(width / 2, oversampling) if shape == "kaiser-bessel" else semicircle(width, oversampling)
        if window.error() < tolerance:
            return window
    return None
