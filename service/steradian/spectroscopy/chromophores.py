"""Absorption spectra of chromophores, from published tables or the user's own.

Sources of the tables:

- haemoglobin: molar extinction, compiled by S. Prahl from W. B. Gratzer and N. Kollias (omlc.org, 1999), each 2 nm;
- water: G. M. Hale and M. R. Querry, Appl. Opt. 12, 555 (1973);
- lipid: mammalian fat, R. L. P. van Veen et al., OSA Biomedical Topical Meeting (2004);
- melanin: interior of a cutaneous melanosome, 1.70·10¹²·(λ/nm)^−3.48 1/cm, S. L. Jacques (omlc.org, 1998);
- ICG: indocyanine green as PATATO 0.7 tabulates it; its spectrum depends on concentration and solvent.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from math import log
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput

Floats = NDArray[np.float64]
_MOLAR = 100 * log(10)  # 1/(m·M) in an extinction of 1/(cm·M)
CHROMOPHORES = ("oxyhaemoglobin", "deoxyhaemoglobin", "water", "lipid", "melanin", "ICG")
"""Names of the chromophores with a table."""
ALIASES = {
    "HbO2": "oxyhaemoglobin",
    "Hb": "deoxyhaemoglobin",
    "HbR": "deoxyhaemoglobin",
    "H2O": "water",
    "Water": "water",
    "fat": "lipid",
    "Lipids": "lipid",
    "Melanin": "melanin",
}
"""Other names of chromophores, those of PATATO included."""


@dataclass(frozen=True, eq=False)
class Chromophore:
    """Absorption spectrum of a chromophore: Napierian absorption coefficient of one unit of it.

    Parameters
    ----------
    name
        Name, unique among those that are unmixed together.
    wavelengths
        In m, rising, shape (n,).
    absorption
        Absorption coefficients in 1/m of one ``unit``, shape (n,), none negative.
    unit
        "mol/L", or "volume fraction".
    source
        Publication of the values.

    Raises
    ------
    InvalidInput
        If the shapes differ, wavelengths do not rise, or a value is negative or not finite.
    """

    name: str
    wavelengths: Floats
    absorption: Floats
    unit: str = "mol/L"
    source: str = ""

    def __post_init__(self) -> None:
        wavelengths, absorption = (np.asarray(each, np.float64) for each in (self.wavelengths, self.absorption))
        if wavelengths.ndim != 1 or len(wavelengths) < 2 or absorption.shape != wavelengths.shape:
            shapes = f"shapes {wavelengths.shape} and {absorption.shape}"
            raise InvalidInput("absorption", shapes, "one value for each of at least two wavelengths")
        if not (np.diff(wavelengths) > 0).all() or not 1e-7 < wavelengths[0] < wavelengths[-1] < 1e-5:
            raise InvalidInput("wavelengths", self.name, "rising, between 100 nm and 10 µm, in metres")
        if not (np.isfinite(absorption) & (absorption >= 0)).all():
            raise InvalidInput("absorption", self.name, "finite, none negative (1/m)")
        object.__setattr__(self, "wavelengths", wavelengths)
        object.__setattr__(self, "absorption", absorption)

    def __repr__(self) -> str:
        first, last = 1e9 * self.wavelengths[[0, -1]]
        return f"<Chromophore: {self.name}, {first:g} to {last:g} nm, per {self.unit}>"

    def at(self, wavelengths: ArrayLike) -> Floats:
        """Return the absorption coefficient in 1/m of one unit at wavelengths in m, interpolated linearly.

        Raises
        ------
        InvalidInput
            If a wavelength lies outside the table.
        """
        wanted = np.asarray(wavelengths, np.float64)
        first, last = self.wavelengths[[0, -1]]
        outside = (wanted < first - 1e-12) | (wanted > last + 1e-12)
        if outside.any():
            value = f"{1e9 * np.atleast_1d(wanted)[np.atleast_1d(outside)][0]:g} nm"
            raise InvalidInput("wavelength", value, f"{1e9 * first:g} to {1e9 * last:g} nm, the table of {self.name}")
        return np.interp(wanted, self.wavelengths, self.absorption)


@cache
def chromophore(name: str) -> Chromophore:
    """Return a chromophore by name or alias.

    Raises
    ------
    InvalidInput
        If there is no table of that name.
    """
    known = ALIASES.get(name, name)
    if known in ("oxyhaemoglobin", "deoxyhaemoglobin"):
        table = _table("haemoglobin")
        column = 1 if known == "oxyhaemoglobin" else 2
        return Chromophore(known, 1e-9 * table[:, 0], _MOLAR * table[:, column], source="S. Prahl 1999")
    if known == "water":
        table = _table("water")
        source = "G. M. Hale and M. R. Querry 1973"
        return Chromophore(known, 1e-9 * table[:, 0], 100 * table[:, 1], "volume fraction", source)
    if known == "lipid":
        table = _table("lipid")
        return Chromophore(known, 1e-9 * table[:, 0], table[:, 1], "volume fraction", "R. L. P. van Veen et al. 2004")
    if known == "melanin":
        nanometres = np.arange(400.0, 1301.0, 2.0)
        absorption = 100 * 1.70e12 * nanometres**-3.48
        return Chromophore(known, 1e-9 * nanometres, absorption, "volume fraction", "S. L. Jacques 1998")
    if known == "ICG":
        table = _table("icg")
        return Chromophore(known, 1e-9 * table[:, 0], _MOLAR * table[:, 1], source="PATATO 0.7")
    raise InvalidInput("chromophore", name, f"{', '.join(CHROMOPHORES)}, or a Chromophore of your own")


def read_chromophore(path: Path, *, name: str | None = None, unit: str = "mol/L") -> Chromophore:
    """Read a spectrum from a CSV file of two columns: wavelength in nm and absorption.

    Absorption is a molar extinction in 1/(cm·M) for the unit "mol/L", and an absorption coefficient in 1/cm for the
    unit "volume fraction". Commas, semicolons, tabs or spaces separate columns; a heading is skipped.

    Raises
    ------
    InvalidInput
        If a row is not two numbers, or the values do not make a spectrum.
    """
    if unit not in ("mol/L", "volume fraction"):
        raise InvalidInput("unit", unit, "mol/L or volume fraction")
    rows: list[list[float]] = []
    for number, line in enumerate(path.read_text(encoding="utf-8-sig").splitlines(), start=1):
        words = line.replace(";", " ").replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            wavelength, value = (float(word) for word in words)
        except ValueError:
            if not rows and number <= 2:
                continue
            raise InvalidInput(f"line {number}", line.strip(), "a wavelength in nm and an absorption") from None
        rows.append([wavelength, value])
    if len(rows) < 2:
        raise InvalidInput("file", path.name, "at least two rows of wavelength in nm and absorption")
    table = np.array(rows)
    factor = _MOLAR if unit == "mol/L" else 100.0
    return Chromophore(name or path.stem, 1e-9 * table[:, 0], factor * table[:, 1], unit, path.name)


def absorption_matrix(chromophores: list[Chromophore], wavelengths: ArrayLike) -> Floats:
    """Return absorption coefficients in 1/m, shape (wavelengths, chromophores)."""
    return np.column_stack([each.at(wavelengths) for each in chromophores])


def _table(name: str) -> Floats:
    text = files("steradian.spectroscopy").joinpath("tables", f"{name}.csv").read_text(encoding="ascii")
    return np.array([line.split(",") for line in text.split()], np.float64)
