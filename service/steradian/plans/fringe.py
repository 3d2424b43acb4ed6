"""Interferometer fringe of the FP sensor: loss of sensitivity by a non-optimal bias wavelength."""

from __future__ import annotations

from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from steradian.core.exceptions import InvalidInput
from steradian.core.validation import Value, quantity_field

NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(9)
"""Mean over a normal distribution, exact for polynomials up to the 17th degree."""


class Fringe(Value):
    r"""Fringe of the FP sensor: reflected level over wavelength; the steepest point is the optimum bias.

    A Lorentzian, :math:`1 - V/(1 + u^2)` with :math:`u = 2(λ - λ_0)/w`, is what a high finesse makes of the Airy
    function :math:`1 - V/(1 + F \sin^2(π(λ - λ_0)/λ_\mathrm{FSR}))`, which a free spectral range asks for.
    """

    linewidth: float = quantity_field("m", "Full width at half depth, w", gt=0, le=1e-7, default=500e-12)
    free_spectral_range: float | None = quantity_field(
        "m", "Distance of fringes of an Airy function; none: a Lorentzian", gt=0, le=1e-6, default=None
    )
    flank: Literal["above", "below"] = "above"
    """On which side of the resonance the film is read; the signal has the other sign on the other one."""

    @model_validator(mode="after")
    def _check(self) -> Fringe:
        if self.free_spectral_range is not None and not 2 * self.linewidth < self.free_spectral_range:
            raise InvalidInput("free_spectral_range", f"{self.free_spectral_range:g}", "> 2 linewidths (m)")
        return self

    def slope(self, offset: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the slope at wavelengths ``offset`` above the resonance (m), in units of V/m of visibility 1."""
        if self.free_spectral_range is None:
            u = 2 * offset / self.linewidth
            slope: NDArray[np.float64] = 4 * u / (1 + u**2) ** 2 / self.linewidth
            return slope
        turn = np.pi / self.free_spectral_range
        finesse = 1 / np.sin(turn * self.linewidth / 2) ** 2
        slope = finesse * turn * np.sin(2 * turn * offset) / (1 + finesse * np.sin(turn * offset) ** 2) ** 2
        return slope

    @cached_property
    def steepest(self) -> float:
        """Distance of the steepest point from the resonance in m; w/√12 for a Lorentzian."""
        if self.free_spectral_range is None:
            return float(self.linewidth / np.sqrt(12))
        from scipy.optimize import minimize_scalar

        found = minimize_scalar(
            lambda offset: -float(self.slope(np.array(offset))),
            bounds=(0, self.linewidth),
            method="bounded",
            options={"xatol": 1e-9 * self.linewidth},
        )
        return float(found.x)

    def sensitivity_loss(self, detuning: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the fraction of sensitivity lost at ``detuning`` (m) above the optimum wavelength.

        0 at the best wavelength, 1 on top of the resonance, more than 1 beyond it, where the signal's sign turns.
        """
        away = detuning if self.flank == "above" else -detuning
        lost: NDArray[np.float64] = 1 - self.slope(self.steepest + away) / self.slope(np.array(self.steepest))
        return lost

    def expected_loss(self, detuning: NDArray[np.float64], uncertainty: float) -> NDArray[np.float64]:
        """Return the mean loss if the optimum wavelength has a standard deviation of ``uncertainty`` (m)."""
        lost = self.sensitivity_loss(np.asarray(detuning)[..., None] + uncertainty * NODES)
        mean: NDArray[np.float64] = lost @ WEIGHTS / WEIGHTS.sum()
        return mean

    def wavelength_tolerance(self, loss: float) -> tuple[float, float]:
        """Return the wavelength range below and above the optimum (m, both ≥ 0) with at most ``loss``."""
        from scipy.optimize import brentq

        def beyond(away: float) -> float:
            return float(self.sensitivity_loss(np.array(away if self.flank == "above" else -away))) - loss

        if not loss > 0:
            return 0.0, 0.0
        far = (self.free_spectral_range or 40 * self.linewidth) / 2 - self.steepest
        inward = -brentq(beyond, -self.steepest, 0.0, xtol=1e-18) if loss < 1 else self.steepest
        outward = brentq(beyond, 0.0, far, xtol=1e-18) if beyond(far) > 0 else far
        inward, outward = float(inward) * (1 - 1e-9), float(outward) * (1 - 1e-9)
        return (inward, outward) if self.flank == "above" else (outward, inward)
