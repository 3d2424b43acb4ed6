"""Planar photoacoustic Fourier reconstruction from arbitrary sensor positions.

An :class:`Acquisition` (A-lines (M, N_t), sensors (M, 2), timing), an :class:`ImageGrid` and a method give a
:class:`Volume` indexed [x, y, z]. Numba is imported by the first run.
"""

from steradian.imaging._reconstruct import Method, reconstruct
from steradian.imaging._uncertainty import uncertainty
from steradian.imaging.acquisition import Acquisition, AcquisitionGeometry
from steradian.imaging.attenuation import ATTENUATIONS, Attenuation
from steradian.imaging.brute_force_reference import direct_spectrum, spectrum_of
from steradian.imaging.film_response import ElasticFilm, FilmResponse, InverseFilter, MeasuredFilm
from steradian.imaging.geometry.sensor_areas import voronoi_weights
from steradian.imaging.iterative_options import Iterative, IterativeOptions
from steradian.imaging.medium import Layer, Medium
from steradian.imaging.options import (
    Compute,
    DirectMethod,
    Gridded,
    ImageGrid,
    LinearKappa,
    NearestKappa,
    Ner,
    Nufft,
)
from steradian.imaging.plan import ReconstructionPlan
from steradian.imaging.sensing_spot import SensingSpot
from steradian.imaging.signal.conditioning import Conditioning, Display, rim_weights
from steradian.imaging.transforms.windows import Window, kaiser_bessel
from steradian.imaging.volume import ReconstructionInfo, Volume, VoxelAxes

__all__ = [
    "ATTENUATIONS",
    "Acquisition",
    "AcquisitionGeometry",
    "Attenuation",
    "Compute",
    "Conditioning",
    "DirectMethod",
    "Display",
    "ElasticFilm",
    "FilmResponse",
    "Gridded",
    "ImageGrid",
    "InverseFilter",
    "Iterative",
    "IterativeOptions",
    "Layer",
    "LinearKappa",
    "MeasuredFilm",
    "Medium",
    "Method",
    "NearestKappa",
    "Ner",
    "Nufft",
    "ReconstructionInfo",
    "ReconstructionPlan",
    "SensingSpot",
    "Volume",
    "VoxelAxes",
    "Window",
    "direct_spectrum",
    "kaiser_bessel",
    "reconstruct",
    "rim_weights",
    "spectrum_of",
    "uncertainty",
    "voronoi_weights",
]
