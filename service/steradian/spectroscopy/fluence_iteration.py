"""Fixed point of absorption and fluence by depth: unmixing gives absorption, this the light, this the next unmixing.

As in the model-based iteration of B. T. Cox et al., Appl. Opt. 45, 1866 (2006), with diffusion in layers by depth in
place of a light model in three dimensions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import as_finite_float
from steradian.imaging.volume import VoxelAxes
from steradian.spectroscopy.chromophores import chromophore
from steradian.spectroscopy.fluence import TissueFluence
from steradian.spectroscopy.linear_inversion import background_covariance, solve_spectra, squared_height

Floats = NDArray[np.float64]
SIGNIFICANCE = 6.0
"""Height above the background, in standard deviations, from which a voxel counts."""
SMOOTHING = 0.3e-3
"""Standard deviation in m of the Gaussian by which blood and saturation are smoothed over depth."""
MOST_PER_DEPTH = 2000
"""Brightest voxels of a depth that are unmixed."""


@dataclass(frozen=True, eq=False)
class LayeredTissueFluence:
    """Fluence in tissue whose blood and saturation depend on depth: e^{−∫μ_eff dz} with the diffusion's μ_eff.

    Parameters
    ----------
    tissue
        Water, lipid and scattering, which are the same at all depths.
    depths
        In m, rising, shape (n,).
    blood, saturation
        Volume fraction of blood and its oxygen saturation at each depth, shape (n,); beyond the ends those of the end.
    """

    tissue: TissueFluence
    depths: Floats
    blood: Floats
    saturation: Floats

    def relative(self, wavelengths: Floats, axes: VoxelAxes) -> Floats:
        """Return the fluence, shape (wavelengths, 1, 1, z)."""
        decay = np.stack(
            [
                replace(self.tissue, blood=float(blood), saturation=float(saturation)).attenuation(wavelengths)
                for blood, saturation in zip(self.blood, self.saturation, strict=True)
            ],
            axis=1,
        )
        between = np.diff(self.depths) * (decay[:, 1:] + decay[:, :-1]) / 2
        path = np.concatenate([np.zeros((len(decay), 1)), np.cumsum(between, axis=1)], axis=1)
        path += decay[:, :1] * self.depths[0]
        reached = np.stack([np.interp(axes.z, self.depths, row) for row in path])
        reached += decay[:, :1] * np.minimum(axes.z - self.depths[0], 0.0)
        reached += decay[:, -1:] * np.maximum(axes.z - self.depths[-1], 0.0)
        return np.asarray(np.exp(-reached)[:, None, None, :])


@dataclass(frozen=True, eq=False)
class IteratedFluence:
    """Result of the fixed point.

    Parameters
    ----------
    fluence
        Fluence of the last round.
    changes
        Change of oxygen saturation in each round: mean over voxels of its absolute value, weighted by haemoglobin.
    converged
        Whether the last change is below the limit.
    """

    fluence: LayeredTissueFluence
    changes: tuple[float, ...] = field(default=())
    converged: bool = False


def iterate_tissue_fluence(
    volumes: ArrayLike,
    wavelengths: Sequence[float],
    axes: VoxelAxes,
    chromophores: Sequence[str] = ("oxyhaemoglobin", "deoxyhaemoglobin"),
    *,
    start: TissueFluence = TissueFluence(),
    change: float = 1e-3,
    rounds: int = 50,
) -> IteratedFluence:
    """Alternate unmixing and fluence until oxygen saturation stays.

    Each round unmixes the voxels above the background, takes their mean saturation at each depth for that of the tissue
    there, and their haemoglobin at each depth for the profile of its blood, whose mean stays that of ``start``: images
    have no absolute unit. It therefore assumes that the imaged vessels are the tissue's absorbers; where they lie in
    tissue of another saturation, :func:`steradian.spectroscopy.fit_tissue_fluence` is better.

    Parameters
    ----------
    volumes
        Series of images, shape (wavelengths, x, y, z), divided by the pulses' energies.
    wavelengths
        In m, at least as many as chromophores.
    axes
        Coordinates of the voxels.
    chromophores
        Absorbers in the imaged objects, both haemoglobins among them.
    start
        Tissue of the first round; its water, lipid, scattering and mean blood stay.
    change
        Change of oxygen saturation below which the iteration ends, above 0, at most 0.1.
    rounds
        Most rounds, 1 to 1000.

    Raises
    ------
    InvalidInput
        If a value is out of range, there are fewer wavelengths than chromophores, or no voxel rises above 6 deviations.
    """
    if not 0 < as_finite_float("change", change, "above 0, at most 0.1") <= 0.1:
        raise InvalidInput("change", change, "above 0, at most 0.1")
    if rounds != int(rounds) or not 1 <= rounds <= 1000:
        raise InvalidInput("rounds", rounds, "a whole number from 1 to 1000")
    light, names = np.asarray(wavelengths, np.float64), list(chromophores)
    pair = [names.index(name) for name in ("oxyhaemoglobin", "deoxyhaemoglobin") if name in names]
    if len(pair) < 2:
        raise InvalidInput("chromophores", ", ".join(names), "both haemoglobins, and others")
    if len(light) < len(names):
        raise InvalidInput("wavelengths", len(light), f"at least {len(names)}, as many as chromophores")
    values = np.asarray(volumes)
    values = values if values.ndim == 4 else values[:, :, None]
    covariance = background_covariance(values)
    spectra = [_significant(values[..., z], covariance[z]) for z in range(values.shape[-1])]
    depths = np.flatnonzero([each.shape[1] > 0 for each in spectra])
    if not len(depths):
        raise InvalidInput("volumes", "no voxel", f"a voxel above {SIGNIFICANCE:g} standard deviations, with an object")
    absorption = np.column_stack([chromophore(name).at(light) for name in names])
    count = len(axes.z)
    fluence = LayeredTissueFluence(start, axes.z, np.full(count, start.blood), np.full(count, start.saturation))
    before, changes = np.zeros(0), []
    for _ in range(int(rounds)):
        relative = fluence.relative(light, axes)[:, 0, 0]
        found = [_blood(spectra[z], absorption, relative[:, z], covariance[z], pair) for z in depths]
        total = np.concatenate([each.sum(axis=0) for each in found])
        saturation = np.concatenate([each[0] for each in found]) / np.maximum(total, np.finfo(np.float64).tiny)
        profile = np.zeros((2, count))
        profile[:, depths] = np.stack([each.sum(axis=1) for each in found], axis=1)
        fluence = _layers(start, axes.z, profile)
        if len(before):
            changes.append(float(np.average(np.abs(saturation - before), weights=total)))
            if changes[-1] < change:
                return IteratedFluence(fluence, tuple(changes), True)
        before = saturation
    return IteratedFluence(fluence, tuple(changes), False)


def _significant(image: NDArray[Any], covariance: Floats) -> Floats:
    """Return the spectra (K, n) of the voxels of a slice (K, x, y) above the background, the brightest ones."""
    spectra = image.reshape(len(image), -1).astype(np.float64)
    height = squared_height(spectra, covariance)
    high = np.flatnonzero((height >= SIGNIFICANCE**2) & (spectra.sum(axis=0) > 0))
    return spectra[:, high[np.argsort(-height[high], kind="stable")[:MOST_PER_DEPTH]]]


def _blood(spectra: Floats, absorption: Floats, fluence: Floats, covariance: Floats, pair: list[int]) -> Floats:
    """Return oxy- and deoxyhaemoglobin (2, n) of spectra (K, n) at one depth."""
    error = covariance / np.outer(fluence, fluence)
    scale = absorption.max()
    found, *_ = solve_spectra(spectra / fluence[:, None], absorption / scale, error, non_negative=True)
    return np.asarray(found[pair])


def _layers(start: TissueFluence, depths: Floats, profile: Floats) -> LayeredTissueFluence:
    """Return the tissue with the profile (2, z) of oxy- and deoxyhaemoglobin, smoothed, and the mean blood of start."""
    step = float(np.diff(depths).mean())
    reach = np.arange(-int(4 * SMOOTHING / step), int(4 * SMOOTHING / step) + 1) * step
    kernel = np.exp(-0.5 * (reach / SMOOTHING) ** 2)
    half = len(kernel) // 2
    smooth = np.stack([np.convolve(np.pad(row, half), kernel / kernel.sum(), "valid") for row in profile])
    total = smooth.sum(axis=0)
    mean = float(profile[0].sum() / profile.sum())
    floor = 1e-6 * float(total.max())
    saturation = np.where(total > floor, smooth[0] / np.maximum(total, floor), mean)
    blood = np.minimum(start.blood * total / float(total.mean()), 1.0)
    return LayeredTissueFluence(start, depths, blood, np.clip(saturation, 0.0, 1.0))
