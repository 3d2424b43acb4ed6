"""Unmixing presets: chromophores and wavelengths, also from PATATO's JSON files."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.spectroscopy.chromophores import ALIASES, CHROMOPHORES


@dataclass(frozen=True)
class UnmixingPreset:
    """Chromophores and wavelengths of an unmixing.

    Parameters
    ----------
    chromophores
        Names, at least one.
    wavelengths
        Wavelengths in m to use; (): all within ``wavelength_range``.
    wavelength_range
        First and last wavelength in m to use; None: no limit.
    non_negative
        Whether concentrations are kept from being negative.
    """

    chromophores: tuple[str, ...]
    wavelengths: tuple[float, ...] = ()
    wavelength_range: tuple[float, float] | None = None
    non_negative: bool = True

    def select(self, wavelengths: ArrayLike) -> NDArray[np.int64]:
        """Return the numbers of those of a series' wavelengths (m) that the preset uses.

        Raises
        ------
        InvalidInput
            If a wavelength of the preset is not among them, or fewer are left than chromophores.
        """
        given = np.asarray(wavelengths, np.float64)
        text = ", ".join(f"{1e9 * each:g}" for each in given) + " nm"
        if self.wavelengths:
            near = np.abs(given[:, None] - np.array(self.wavelengths)) < 0.5e-9
            if not near.any(axis=0).all():
                missing = self.wavelengths[int(np.argmin(near.any(axis=0)))]
                raise InvalidInput("wavelength", f"{1e9 * missing:g} nm", f"one of the series: {text}")
            used = near.any(axis=1)
        else:
            low, high = self.wavelength_range or (0.0, np.inf)
            used = (given >= low - 0.5e-9) & (given <= high + 0.5e-9)
        if used.sum() < len(self.chromophores):
            allowed = f"at least {len(self.chromophores)} for {', '.join(self.chromophores)}"
            raise InvalidInput("wavelengths", f"{used.sum()} of {text}", allowed)
        return np.flatnonzero(used)


def read_patato_preset(path: Path) -> UnmixingPreset:
    """Read an unmixing preset of PATATO (``unmix_presets/*.json``).

    ``SPECTRA``, ``WAVELENGTHS``, ``WAVELENGTH_RANGE`` (nm) and ``NONNEG`` are used; what concerns PATATO's image grid
    and file names (``RESOLUTION_REDUCE``, ``SUFFIX``, ``SO2``, ``WATER_CORR``) is not.

    Raises
    ------
    InvalidInput
        If the file is not such a preset; it names the field.
    """
    try:
        fields: Any = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InvalidInput("preset", path.name, f"JSON ({error})") from None
    spectra = fields.get("SPECTRA") if isinstance(fields, dict) else None
    if not isinstance(spectra, list) or not spectra or not all(isinstance(each, str) for each in spectra):
        raise InvalidInput("SPECTRA", repr(spectra), "a list of names of chromophores")
    names = tuple(str(ALIASES.get(each, each)) for each in spectra)
    for each in names:
        if each not in CHROMOPHORES:
            raise InvalidInput("SPECTRA", each, f"{', '.join((*CHROMOPHORES, *ALIASES))}")
    ends = _nanometres("WAVELENGTH_RANGE", fields.get("WAVELENGTH_RANGE"))
    if ends and (len(ends) != 2 or not ends[0] < ends[1]):
        raise InvalidInput("WAVELENGTH_RANGE", fields["WAVELENGTH_RANGE"], "two wavelengths in nm, rising")
    wavelengths = _nanometres("WAVELENGTHS", fields.get("WAVELENGTHS"))
    limits = (ends[0], ends[1]) if ends else None
    return UnmixingPreset(names, wavelengths, limits, bool(fields.get("NONNEG", True)))


def _nanometres(field: str, values: Any) -> tuple[float, ...]:
    """Return wavelengths in m of a list in nm; () for None."""
    if values is None:
        return ()
    numbers = isinstance(values, list) and all(isinstance(each, int | float) for each in values)
    if not numbers or not all(100 < each < 10_000 for each in values):
        raise InvalidInput(field, repr(values), "a list of wavelengths from 100 to 10000 nm")
    return tuple(1e-9 * each for each in values)
