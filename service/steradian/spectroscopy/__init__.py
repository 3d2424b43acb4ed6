"""Optical spectroscopy of series of volumes: chromophores, fluence, linear unmixing and oxygen saturation."""

from steradian.spectroscopy.chromophores import CHROMOPHORES, Chromophore, chromophore, read_chromophore
from steradian.spectroscopy.fluence import (
    ExponentialFluence,
    Fluence,
    TissueFluence,
    UniformFluence,
    fit_tissue_fluence,
)
from steradian.spectroscopy.fluence_iteration import IteratedFluence, LayeredTissueFluence, iterate_tissue_fluence
from steradian.spectroscopy.fluence_map import FluenceMap
from steradian.spectroscopy.presets import UnmixingPreset, read_patato_preset
from steradian.spectroscopy.unmixing import Unmixed, unmix
from steradian.spectroscopy.wavelength_design import WavelengthSet, best_wavelengths, wavelength_set

__all__ = [
    "CHROMOPHORES",
    "Chromophore",
    "ExponentialFluence",
    "Fluence",
    "FluenceMap",
    "IteratedFluence",
    "LayeredTissueFluence",
    "TissueFluence",
    "UniformFluence",
    "Unmixed",
    "UnmixingPreset",
    "WavelengthSet",
    "best_wavelengths",
    "chromophore",
    "fit_tissue_fluence",
    "iterate_tissue_fluence",
    "read_chromophore",
    "read_patato_preset",
    "unmix",
    "wavelength_set",
]
