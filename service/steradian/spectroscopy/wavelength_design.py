"""Optimal design of wavelengths: expected error of oxygen saturation of a set, and the best set of a laser's list."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import as_finite_float
from steradian.spectroscopy.chromophores import Chromophore, absorption_matrix, chromophore
from steradian.spectroscopy.fluence import HAEMOGLOBIN, TissueFluence

Floats = NDArray[np.float64]
HAEMOGLOBINS = ("oxyhaemoglobin", "deoxyhaemoglobin")
SATURATIONS = np.linspace(0.5, 1.0, 6)
"""Oxygen saturations that the error is averaged over."""
MOST_WAVELENGTHS = 500
SAME = 0.5e-9
"""Distance in m below which two wavelengths are one."""


@dataclass(frozen=True)
class WavelengthSet:
    """Set of wavelengths with its expected error of oxygen saturation for blood at a depth.

    Parameters
    ----------
    wavelengths
        In m, rising.
    condition
        Condition number of the chromophores' spectra at them, each scaled to norm 1 and with the fluence of the depth.
    saturation_error
        Expected standard error of oxygen saturation of one voxel, root mean square over saturations of 0.5 to 1.
    depth, noise
        As asked for.
    """

    wavelengths: tuple[float, ...]
    condition: float
    saturation_error: float
    depth: float
    noise: float

    def __str__(self) -> str:
        light = ", ".join(f"{1e9 * each:g}" for each in self.wavelengths)
        return (
            f"{light} nm: sO2 ± {self.saturation_error:.2g} at {1e3 * self.depth:g} mm, condition {self.condition:.3g}"
        )


def wavelength_set(
    wavelengths: Sequence[float],
    chromophores: Sequence[str | Chromophore] = HAEMOGLOBINS,
    *,
    depth: float = 3e-3,
    noise: float = 0.03,
    tissue: TissueFluence = TissueFluence(),
) -> WavelengthSet:
    """Return condition number and expected error of oxygen saturation of a set of wavelengths (Cramér–Rao bound).

    Parameters
    ----------
    wavelengths
        In m.
    chromophores
        That are unmixed, both haemoglobins among them.
    depth
        Of the blood in m, 0 to 0.1.
    noise
        Standard deviation of a voxel, as a share of the value of blood at the film's surface at the brightest of 700 to
        900 nm and a saturation of 0.75; pulses of one energy.
    tissue
        Around the blood, which takes and colours the light.

    Raises
    ------
    InvalidInput
        If a value is out of range, or there are fewer wavelengths than chromophores.
    """
    light = _checked(wavelengths, "wavelengths")
    sensitivity = _sensitivity(light, chromophores, depth, noise, tissue)
    if len(light) < sensitivity.shape[1]:
        raise InvalidInput("wavelengths", len(light), f"at least {sensitivity.shape[1]}, as many as chromophores")
    return _described(light, sensitivity, depth, noise)


def best_wavelengths(
    candidates: Sequence[float],
    count: int,
    chromophores: Sequence[str | Chromophore] = HAEMOGLOBINS,
    *,
    depth: float = 3e-3,
    noise: float = 0.03,
    tissue: TissueFluence = TissueFluence(),
) -> WavelengthSet:
    """Return the set of ``count`` wavelengths of a list with the least expected error of oxygen saturation.

    Found by exchange (V. V. Fedorov 1972) from the best set that grows one by one, until no exchange of one wavelength
    helps. Parameters and errors as of :func:`wavelength_set`; ``candidates`` in m, at least ``count``.
    """
    light = _checked(candidates, "candidates")
    sensitivity = _sensitivity(light, chromophores, depth, noise, tissue)
    least = sensitivity.shape[1]
    if count != int(count) or not least <= count <= len(light):
        raise InvalidInput("count", count, f"a whole number from {least} to {len(light)}, the number of candidates")
    chosen: list[int] = []
    for _ in range(int(count)):
        free = [each for each in range(len(light)) if each not in chosen]
        chosen.append(min(free, key=lambda each: _error(sensitivity[[*chosen, each]])))
    error = _error(sensitivity[chosen])
    while True:
        trials = [
            ([*chosen[:place], *chosen[place + 1 :], each])
            for place in range(len(chosen))
            for each in range(len(light))
            if each not in chosen
        ]
        found = min(trials, key=lambda trial: _error(sensitivity[trial]), default=chosen)
        lower = _error(sensitivity[found])
        if not lower < error * (1 - 1e-9):
            break
        chosen, error = found, lower
    chosen.sort()
    return _described(light[chosen], sensitivity[chosen], depth, noise)


def _sensitivity(
    light: Floats, chromophores: Sequence[str | Chromophore], depth: float, noise: float, tissue: TissueFluence
) -> Floats:
    """Return the spectra of blood's worth of each chromophore at the depth, in standard deviations of the noise."""
    spectra = [each if isinstance(each, Chromophore) else chromophore(each) for each in chromophores]
    names = [each.name for each in spectra]
    if len(set(names)) < len(names) or names[:2] != list(HAEMOGLOBINS):
        raise InvalidInput("chromophores", ", ".join(names), f"{', '.join(HAEMOGLOBINS)} first, and others each once")
    if not 0 <= as_finite_float("depth", depth, "0 to 0.1 m") <= 0.1:
        raise InvalidInput("depth", depth, "0 to 0.1 m")
    if not 0 < as_finite_float("noise", noise, "above 0, a share of blood at the surface") <= 10:
        raise InvalidInput("noise", noise, "above 0, at most 10, a share of blood at the surface")
    matrix = HAEMOGLOBIN * absorption_matrix(spectra, light)
    blood = [chromophore(name).at(np.arange(700e-9, 901e-9, 10e-9)) for name in HAEMOGLOBINS]
    brightest = HAEMOGLOBIN * float(np.max(0.75 * blood[0] + 0.25 * blood[1]))
    fluence = np.exp(-tissue.attenuation(light) * depth)
    return np.asarray(fluence[:, None] * matrix / (brightest * noise))


def _error(sensitivity: Floats) -> float:
    """Return the root mean square error of oxygen saturation; of too few wavelengths a ridge's, which ranks them."""
    normal = sensitivity.T @ sensitivity
    scale = np.sqrt(np.diag(normal))
    scale[scale == 0] = 1.0
    scaled = normal / np.outer(scale, scale)
    if len(sensitivity) < sensitivity.shape[1]:
        scaled = scaled + 1e-6 * np.eye(len(scaled))
    spread = np.linalg.pinv(scaled, hermitian=True, rcond=1e-14) / np.outer(scale, scale)
    slopes = np.stack([1 - SATURATIONS, -SATURATIONS])
    return float(np.sqrt(np.mean(np.einsum("is,ij,js->s", slopes, spread[:2, :2], slopes))))


def _described(light: Floats, sensitivity: Floats, depth: float, noise: float) -> WavelengthSet:
    condition = float(np.linalg.cond(sensitivity / np.linalg.norm(sensitivity, axis=0)))
    return WavelengthSet(tuple(map(float, light)), condition, _error(sensitivity), float(depth), float(noise))


def _checked(wavelengths: Sequence[float], field: str) -> Floats:
    light = np.sort(np.asarray(wavelengths, np.float64))
    if light.ndim != 1 or not 1 <= len(light) <= MOST_WAVELENGTHS:
        raise InvalidInput(field, f"shape {light.shape}", f"1 to {MOST_WAVELENGTHS} wavelengths in m")
    if (np.diff(light) < SAME).any():
        raise InvalidInput(field, ", ".join(f"{1e9 * each:g}" for each in light), "each once, 0.5 nm apart at least")
    return light
