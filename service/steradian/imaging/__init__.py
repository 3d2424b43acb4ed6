"""Planar photoacoustic Fourier reconstruction from arbitrary sensor positions.

Traces (M, N_t) and positions (M, 2) in; a :class:`Volume` indexed [x, y, z] out. Numba is imported by the first run.
"""

from steradian.imaging._reconstruct import reconstruct
from steradian.imaging.film_response import ElasticFilm, FilmResponse, InverseFilter, MeasuredFilm
from steradian.imaging.geometry.sensor_areas import voronoi_weights
from steradian.imaging.iterative_options import Iterative
from steradian.imaging.plan import ReconstructionPlan
from steradian.imaging.reference import direct_spectrum, spectrum_of
from steradian.imaging.signal.conditioning import Conditioning, Display, rim_weights
from steradian.imaging.transforms.windows import Window, kaiser_bessel
from steradian.imaging.volume import Volume, VoxelAxes

__all__ = [
    "Conditioning",
    "Display",
    "ElasticFilm",
    "FilmResponse",
    "InverseFilter",
    "Iterative",
    "MeasuredFilm",
    "ReconstructionPlan",
    "Volume",
    "VoxelAxes",
    "Window",
    "direct_spectrum",
    "kaiser_bessel",
    "reconstruct",
    "rim_weights",
    "spectrum_of",
    "voronoi_weights",
]
