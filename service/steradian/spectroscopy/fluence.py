"""Fluence models: light that reaches a depth at each wavelength, relative to the same surface.

Photoacoustic pressure is p₀ = Γ·μ_a·Φ. Without the fluence Φ(λ, z) the colour of the light at a depth is taken for the
colour of the absorber, and oxygen saturation is wrong by more than 0.15 at a few millimetres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import as_finite_float
from steradian.imaging.volume import VoxelAxes
from steradian.spectroscopy.chromophores import chromophore
from steradian.spectroscopy.linear_inversion import background_covariance, brightest_spectra, misfit

Floats = NDArray[np.float64]
HAEMOGLOBIN = 150 / 64_500
"""Haemoglobin in whole blood, in mol/L: 150 g/L at 64,500 g/mol (S. Prahl)."""


class Fluence(Protocol):
    """Protocol of a fluence model."""

    def relative(self, wavelengths: Floats, axes: VoxelAxes) -> Floats:
        """Return the fluence, broadcastable to (wavelengths, x, y, z), for wavelengths in m."""


@dataclass(frozen=True)
class UniformFluence:
    """Fluence that is the same everywhere.

    Parameters
    ----------
    surface
        Relative fluence of each wavelength, for series whose A-lines were not divided by the pulses' energies; (): 1.
    """

    surface: tuple[float, ...] = ()

    def relative(self, wavelengths: Floats, axes: VoxelAxes) -> Floats:
        """Return the fluence, shape (wavelengths, 1, 1, 1)."""
        del axes
        return _per_wavelength("surface", self.surface or (1.0,) * len(wavelengths), wavelengths)[:, None, None, None]


@dataclass(frozen=True)
class ExponentialFluence:
    """Fluence that decays exponentially with depth, e^{−μ_eff·z}.

    Parameters
    ----------
    attenuation
        Effective attenuation coefficient μ_eff of each wavelength in 1/m.
    surface
        Relative fluence at the film of each wavelength; (): 1.
    """

    attenuation: tuple[float, ...]
    surface: tuple[float, ...] = ()

    def relative(self, wavelengths: Floats, axes: VoxelAxes) -> Floats:
        """Return the fluence, shape (wavelengths, 1, 1, z)."""
        decay = _per_wavelength("attenuation", self.attenuation, wavelengths)
        surface = _per_wavelength("surface", self.surface or (1.0,) * len(wavelengths), wavelengths)
        return (surface[:, None] * np.exp(-decay[:, None] * axes.z))[:, None, None, :]


@dataclass(frozen=True)
class TissueFluence:
    """Fluence in homogeneous tissue by diffusion, e^{−μ_eff·z} with μ_eff = √(3μ_a(μ_a + μ_s′)).

    Tissue composition and reduced scattering μ_s′ = scattering·(λ/500 nm)^−scattering_power as in S. L. Jacques, Phys.
    Med. Biol. 58, R37 (2013).

    Parameters
    ----------
    blood, water, lipid
        Volume fractions of whole blood (150 g/L haemoglobin), water and lipid, 0 to 1.
    saturation
        Oxygen saturation of that blood, 0 to 1.
    scattering
        Reduced scattering at 500 nm in 1/m.
    scattering_power
        Exponent of its fall with the wavelength.

    Raises
    ------
    InvalidInput
        If a value is out of range.
    """

    blood: float = 0.02
    saturation: float = 0.7
    water: float = 0.65
    lipid: float = 0.1
    scattering: float = 2000.0
    scattering_power: float = 1.3

    def __post_init__(self) -> None:
        limits = {"scattering": (1.0, 1e5), "scattering_power": (0.0, 4.0)}
        for name in ("blood", "saturation", "water", "lipid", "scattering", "scattering_power"):
            low, high = limits.get(name, (0.0, 1.0))
            allowed = f"from {low:g} to {high:g}"
            value = as_finite_float(name, getattr(self, name), allowed)
            if not low <= value <= high:
                raise InvalidInput(name, value, allowed)
            object.__setattr__(self, name, value)

    def attenuation(self, wavelengths: ArrayLike) -> Floats:
        """Return the effective attenuation coefficient μ_eff in 1/m at wavelengths in m."""
        light = np.asarray(wavelengths, np.float64)
        oxygenated, deoxygenated = (chromophore(name).at(light) for name in ("oxyhaemoglobin", "deoxyhaemoglobin"))
        blood = HAEMOGLOBIN * (self.saturation * oxygenated + (1 - self.saturation) * deoxygenated)
        absorption = self.blood * blood + self.water * chromophore("water").at(light)
        absorption += self.lipid * chromophore("lipid").at(light)
        scattered = self.scattering * (light / 500e-9) ** -self.scattering_power
        return np.sqrt(3 * absorption * (absorption + scattered))

    def relative(self, wavelengths: Floats, axes: VoxelAxes) -> Floats:
        """Return the fluence, shape (wavelengths, 1, 1, z)."""
        return np.exp(-self.attenuation(wavelengths)[:, None] * axes.z)[:, None, None, :]


@dataclass(frozen=True)
class FittedFluence:
    """Tissue fluence fitted to a series.

    Parameters
    ----------
    fluence
        Model with the fitted values.
    standard_errors
        Standard errors of ``blood`` and ``saturation``, those of their priors included.
    misfit_before, misfit
        Mean squared residual of the brightest spectra in units of their variance, at the start and at the end.
    """

    fluence: TissueFluence
    standard_errors: dict[str, float]
    misfit_before: float
    misfit: float


PRIOR_BLOOD, PRIOR_SATURATION = np.log(3.0), 0.15
"""Prior standard deviations of the blood's volume fraction, as a factor's logarithm, and of its saturation."""
SPECTRA = 4000
"""Brightest voxels that a fit uses."""


def fit_tissue_fluence(
    volumes: ArrayLike,
    wavelengths: Sequence[float],
    axes: VoxelAxes,
    chromophores: Sequence[str] = ("oxyhaemoglobin", "deoxyhaemoglobin"),
    *,
    start: TissueFluence = TissueFluence(),
) -> FittedFluence:
    """Fit blood fraction and saturation of the tissue around absorbers, by the misfit of their unmixing.

    Absorbers at several depths, with one unknown spectrum each, are unmixed with the fluence of each candidate; what
    is left decides (variable projection, G. H. Golub and V. Pereyra 1973). Priors about ``start`` keep what the series
    does not tell: a factor of 3 for the blood's fraction, 0.15 for its saturation.

    Parameters
    ----------
    volumes
        Series of images, shape (wavelengths, x, y, z), divided by the pulses' energies.
    wavelengths
        In m, more than chromophores.
    axes
        Coordinates of the voxels.
    chromophores
        Absorbers in the imaged objects.
    start
        Tissue at which the fit starts; water, lipid and scattering stay.

    Raises
    ------
    InvalidInput
        If there are not more wavelengths than chromophores, or no voxel rises above the background.
    """
    from scipy.optimize import least_squares

    light = np.asarray(wavelengths, np.float64)
    if len(light) <= len(chromophores):
        allowed = f"more than the {len(chromophores)} chromophores, to tell the fluence from them"
        raise InvalidInput("wavelengths", len(light), allowed)
    values = np.asarray(volumes)
    covariance = background_covariance(values)
    spectra, slices = brightest_spectra(values, covariance, SPECTRA)
    absorption = np.column_stack([chromophore(name).at(light) for name in chromophores])
    depths = axes.z[slices]

    def tissue(x: Any) -> TissueFluence:
        return replace(start, blood=min(1.0, start.blood * float(np.exp(x[0]))), saturation=float(np.clip(x[1], 0, 1)))

    def residuals(x: Any) -> Floats:
        fluence = np.exp(-tissue(x).attenuation(light)[:, None] * depths)
        left = misfit(spectra, absorption, fluence, covariance[slices])
        prior = [x[0] / PRIOR_BLOOD, (x[1] - start.saturation) / PRIOR_SATURATION]
        return np.concatenate([left.ravel() / np.sqrt(CORRELATED), prior])

    first = np.array([0.0, start.saturation])
    found = least_squares(residuals, first, x_scale=(PRIOR_BLOOD, PRIOR_SATURATION), diff_step=np.array([1e-3, 1e-3]))
    slopes: Floats = np.asarray(found.jac)
    errors = np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))
    fitted = tissue(found.x)
    freedom = (len(light) - len(chromophores)) * spectra.shape[1] / CORRELATED
    before = float(np.sum(residuals(first)[:-2] ** 2) / freedom)
    after = float(np.sum(residuals(found.x)[:-2] ** 2) / freedom)
    told = {"blood": float(errors[0] * fitted.blood), "saturation": float(errors[1])}
    return FittedFluence(fitted, told, before, after)


CORRELATED = 25.0
"""Voxels of an image that share one error: those of a resolution cell."""


def _per_wavelength(field: str, values: Sequence[float], wavelengths: Floats) -> Floats:
    numbers = np.asarray(values, np.float64)
    if numbers.shape != wavelengths.shape or not (np.isfinite(numbers) & (numbers >= 0)).all():
        raise InvalidInput(field, str(tuple(values)), f"{len(wavelengths)} numbers from 0, one a wavelength")
    return numbers
