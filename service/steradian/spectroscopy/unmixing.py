"""Linear spectral unmixing of a series of volumes into chromophores, with oxygen saturation and its uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging.volume import Volume
from steradian.spectroscopy.chromophores import Chromophore, absorption_matrix, chromophore
from steradian.spectroscopy.fluence import Fluence, UniformFluence
from steradian.spectroscopy.linear_inversion import (
    MOST_CHROMOPHORES,
    background_covariance,
    solve_spectra,
    squared_height,
)

Floats = NDArray[np.float64]
NO_FLUENCE = (
    "without a fluence the light is taken to have one colour at all depths: oxygen saturation is biased, by more than "
    "0.15 at a few millimetres of tissue"
)
SIGNIFICANCE = 6.0
"""Height above the background, in standard deviations, from which a voxel has a value."""


@dataclass(frozen=True, eq=False)
class Unmixed:
    """Result of an unmixing; voxels without signal are NaN.

    Parameters
    ----------
    chromophores
        Names, in the order of the first axis of ``concentrations``.
    concentrations, standard_errors
        Relative concentrations and their standard errors (68 %), shape (chromophores, x, y, z). The unit is the
        images' over that of Γ·Φ, which is not known: ratios are absolute, concentrations are not.
    saturation, saturation_error
        Oxygen saturation, 0 to 1, and its standard error, shape (x, y, z); None without both haemoglobins.
    haemoglobin, haemoglobin_error
        Total haemoglobin and its standard error, in the unit of ``concentrations``; None without both.
    volume
        Volume of the first wavelength, for axes and spacing.
    misfit
        Mean squared residual of a voxel's spectrum in units of its variance (reduced χ²); None without more wavelengths
        than chromophores. Far above 1 spectra or fluence do not fit.
    notes
        Assumptions and warnings.
    """

    chromophores: tuple[str, ...]
    concentrations: NDArray[np.float32]
    standard_errors: NDArray[np.float32]
    saturation: NDArray[np.float32] | None
    saturation_error: NDArray[np.float32] | None
    haemoglobin: NDArray[np.float32] | None
    haemoglobin_error: NDArray[np.float32] | None
    volume: Volume
    misfit: float | None = None
    notes: tuple[str, ...] = ()

    @property
    def has_signal(self) -> NDArray[np.bool_]:
        """Boolean array (x, y, z) of the voxels with values."""
        return np.asarray(np.isfinite(self.concentrations[0]))

    def as_volume(self, name: str) -> Volume:
        """Return a chromophore's concentration, "saturation", "saturation-error" or "haemoglobin" as a volume.

        Raises
        ------
        InvalidInput
            If there is none of that name.
        """
        maps: dict[str, Any] = dict(zip(self.chromophores, self.concentrations, strict=True))
        blood = {"saturation": self.saturation, "saturation-error": self.saturation_error}
        maps |= {n: each for n, each in (blood | {"haemoglobin": self.haemoglobin}).items() if each is not None}
        if name not in maps:
            raise InvalidInput("name", name, ", ".join(maps))
        of = self.volume
        return Volume(maps[name].reshape(of.values.shape), of.axes, of.spacing, of.sound_speed)


def unmix(
    volumes: Sequence[Volume],
    wavelengths: Sequence[float],
    chromophores: Sequence[str | Chromophore] = ("oxyhaemoglobin", "deoxyhaemoglobin"),
    *,
    fluence: Fluence | None = None,
    covariance: ArrayLike | None = None,
    non_negative: bool = True,
    significance: float = SIGNIFICANCE,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Unmixed:
    """Unmix volumes of several wavelengths into chromophores by weighted least squares.

    Parameters
    ----------
    volumes
        Images on the same voxels, divided by the pulses' energies.
    wavelengths
        Of the images in m; as many at least as chromophores.
    chromophores
        Names (:data:`steradian.spectroscopy.CHROMOPHORES`) or spectra, up to 6.
    fluence
        Model of the light; None: the same everywhere, with a warning in ``notes``.
    covariance
        Covariance between wavelengths of a voxel's error, shape (K, K) or (z, K, K); None: that of the images'
        background at each depth, which has noise and streaks, scaled such that the residuals are as large as expected.
    non_negative
        Keep concentrations from being negative.
    significance
        Height above the background in standard deviations from which a voxel has a value.
    progress, cancelled
        See :mod:`steradian.core.progress`.

    Raises
    ------
    InvalidInput
        If shapes differ, there are fewer wavelengths than chromophores, or these cannot be told apart.
    Cancelled
        If ``cancelled`` returned true.
    """
    spectra = [each if isinstance(each, Chromophore) else chromophore(each) for each in chromophores]
    light = np.asarray(wavelengths, np.float64)
    _check(volumes, light, spectra)
    matrix = absorption_matrix(spectra, light)
    scale = matrix.max()
    first = volumes[0]
    shape = first.values.shape if first.values.ndim == 3 else (first.values.shape[0], 1, first.values.shape[1])
    values = np.stack([np.asarray(each.values).reshape(shape) for each in volumes])
    model = UniformFluence() if fluence is None else fluence
    relative = model.relative(light, first.axes)
    errors = background_covariance(values) if covariance is None else np.asarray(covariance, np.float64)
    depths, count = shape[-1], len(spectra)
    errors = np.broadcast_to(errors, (depths, len(light), len(light)))
    found = np.full((count, *shape), np.nan, np.float32)
    deviation = np.full((count, *shape), np.nan, np.float32)
    names = tuple(each.name for each in spectra)
    pair = [names.index(name) for name in ("oxyhaemoglobin", "deoxyhaemoglobin") if name in names]
    maps = np.full((4, *shape), np.nan, np.float32) if len(pair) == 2 else None
    residuals: list[Floats] = [np.zeros(0)]
    for z in range(depths):
        if cancelled is not None and cancelled():
            raise Cancelled("cancelled during: unmixing")
        light_here = np.broadcast_to(relative, (len(light), *relative.shape[1:3], relative.shape[3]))
        light_here = light_here[..., z if relative.shape[3] > 1 else 0]
        mean = light_here.mean(axis=(1, 2))
        data = (values[..., z] / light_here).reshape(len(light), -1).astype(np.float64)
        error = errors[z] / np.outer(mean, mean)
        high = np.flatnonzero(squared_height(data, error) >= significance**2)  # what is explained is not higher
        solution, spread, explained, left = solve_spectra(
            data[:, high], matrix / scale, error, non_negative=non_negative
        )
        inside = explained >= significance**2
        residuals.append(left[inside])
        solution, places = solution[:, inside], np.unravel_index(high[inside], shape[:2])
        found[:, places[0], places[1], z] = solution / scale
        deviation[:, places[0], places[1], z] = (np.sqrt(np.diag(spread)) / scale)[:, None]
        if maps is not None:
            maps[:, places[0], places[1], z] = _oxygenation(solution[pair], spread[np.ix_(pair, pair)], scale)
        if progress is not None:
            progress("unmixing", z + 1, depths)
    freedom, left = len(light) - count, np.concatenate(residuals)
    misfit = float(left.mean()) / freedom if freedom and left.size else None
    if covariance is None and misfit is not None:  # an object's own streaks are not those of its background
        deviation *= np.float32(np.sqrt(misfit))
        if maps is not None:
            maps[1::2] *= np.float32(np.sqrt(misfit))
    notes = (NO_FLUENCE,) if fluence is None else ()
    saturation, saturation_error, haemoglobin, haemoglobin_error = (None,) * 4 if maps is None else maps
    return Unmixed(
        names, found, deviation, saturation, saturation_error, haemoglobin, haemoglobin_error, first, misfit, notes
    )


def _oxygenation(pair: Floats, spread: Floats, scale: float) -> Floats:
    """Return saturation, its error, total haemoglobin and its error (4, n), errors to first order."""
    total = pair.sum(axis=0)
    safe = np.where(total > 0, total, np.nan)
    saturation = pair[0] / safe
    slopes = np.stack([pair[1], -pair[0]]) / safe**2
    error = np.sqrt(np.einsum("in,ij,jn->n", slopes, spread, slopes))
    total_error = np.full_like(total, np.sqrt(spread.sum()) / scale)
    return np.stack([saturation, error, total / scale, total_error])


def _check(volumes: Sequence[Volume], wavelengths: Floats, chromophores: Sequence[Chromophore]) -> None:
    names = [each.name for each in chromophores]
    if not 1 <= len(names) <= MOST_CHROMOPHORES or len(set(names)) < len(names):
        raise InvalidInput("chromophores", ", ".join(names) or "none", f"1 to {MOST_CHROMOPHORES}, each once")
    if wavelengths.ndim != 1 or len(volumes) != len(wavelengths):
        raise InvalidInput("wavelengths", len(wavelengths), f"one for each of {len(volumes)} volumes")
    if len(wavelengths) < len(names):
        raise InvalidInput("wavelengths", len(wavelengths), f"at least {len(names)}, as many as chromophores")
    if len(set(np.round(1e9 * wavelengths, 3))) < len(wavelengths):
        raise InvalidInput("wavelengths", ", ".join(f"{1e9 * each:g}" for each in wavelengths), "each once")
    for each in volumes[1:]:
        if each.values.shape != volumes[0].values.shape:
            raise InvalidInput(
                "volumes", f"a shape {each.values.shape}", f"that of the first, {volumes[0].values.shape}"
            )
    matrix = absorption_matrix(list(chromophores), wavelengths)
    conditioned = np.linalg.cond(matrix / np.linalg.norm(matrix, axis=0))
    if not conditioned < 1e6:
        raise InvalidInput("chromophores", ", ".join(names), "ones that these wavelengths tell apart")
