"""Options of an unmixing: chromophores, wavelengths and the model of the light."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from annotated_types import Interval
from pydantic import ConfigDict, Field, StringConstraints, model_validator

from steradian.core.exceptions import InvalidInput
from steradian.core.validation import Value, quantity_field
from steradian.jobs.request_base import Name

Share = Annotated[float, Interval(ge=0, le=1)]
Wavelength = Annotated[float, Interval(ge=1e-7, le=1e-5)]
RESERVED = ("saturation", "saturation-error", "haemoglobin")
BLOOD = ("oxyhaemoglobin", "deoxyhaemoglobin")


class OwnSpectrum(Value):
    """Absorption spectrum of a chromophore that is not among the known ones."""

    name: Annotated[Name, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9 _.+-]*$")]
    wavelengths: tuple[Wavelength, ...] = Field(min_length=2, max_length=2000, description="Rising (m)")
    absorption: tuple[Annotated[float, Interval(ge=0, le=1e12)], ...] = Field(
        min_length=2, max_length=2000, description="Napierian, of one unit of it, at each wavelength (1/m)"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.name in RESERVED:
            raise InvalidInput("name", self.name, f"another one than the maps {', '.join(RESERVED)}")
        if len(self.absorption) != len(self.wavelengths):
            raise InvalidInput("absorption", len(self.absorption), f"as many as wavelengths, {len(self.wavelengths)}")
        if any(later <= earlier for earlier, later in zip(self.wavelengths, self.wavelengths[1:], strict=False)):
            raise InvalidInput("wavelengths", self.name, "rising")
        return self


class FluenceRequest(Value):
    """Model of the light at a depth; the tissue around matters to the models tissue, fit and iterate."""

    model: Literal["none", "uniform", "tissue", "fit", "iterate"] = Field(
        default="none",
        description="none: the same everywhere, with a warning; uniform: the same, on purpose; tissue: falls with depth"
        " as stated below; fit: blood and saturation of the tissue are fitted to the series, from the values below;"
        " iterate: its blood by depth follows from the unmixing",
    )
    blood: Share = Field(default=0.02, description="Volume fraction of blood")
    saturation: Share = Field(default=0.7, description="Oxygen saturation of that blood")
    water: Share = Field(default=0.65, description="Volume fraction of water")
    lipid: Share = Field(default=0.1, description="Volume fraction of lipid")
    scattering: float = quantity_field("1/m", "Reduced scattering at 500 nm", default=2000.0, ge=1, le=1e5)
    scattering_power: float = Field(default=1.3, ge=0, le=4, description="Exponent of its fall with the wavelength")


class UnmixingOptions(Value):
    """Unmixing of a series of several wavelengths into chromophores, and oxygen saturation where both are of blood."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"fluence": {"model": "fit"}}]})

    chromophores: tuple[Name, ...] = Field(
        default=BLOOD,
        min_length=1,
        max_length=6,
        description="Known ones (oxyhaemoglobin, deoxyhaemoglobin, water, lipid, melanin, ICG), and those of spectra",
    )
    spectra: tuple[OwnSpectrum, ...] = Field(default=(), max_length=6, description="Spectra of further chromophores")
    wavelengths: tuple[Wavelength, ...] = Field(
        default=(), max_length=100, description="Those of the series that are used (m); none: all"
    )
    fluence: FluenceRequest = FluenceRequest()
    non_negative: bool = Field(default=True, description="Keep concentrations from being negative")
    significance: float = Field(
        default=6.0, ge=0, le=1e3, description="Height above the background from which a voxel has a value, in σ"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        known = dict.fromkeys(each.name for each in self.spectra)
        if len(known) < len(self.spectra):
            raise InvalidInput("spectra", ", ".join(each.name for each in self.spectra), "one of each name")
        if self.fluence.model in ("fit", "iterate") and self.spectra:
            raise InvalidInput("fluence.model", self.fluence.model, "none, uniform or tissue beside spectra")
        return self
