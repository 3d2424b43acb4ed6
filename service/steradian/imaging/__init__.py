"""Planar photoacoustic Fourier reconstruction from arbitrary sensor positions.

Traces (M, N_t) and positions (M, 2) in; a :class:`Volume` indexed [x, y, z] out. Numba is imported by the first run.
"""

from steradian.imaging.conditioning import Conditioning, Display, rim_weights
from steradian.imaging.direct import direct_spectrum, spectrum_of
from steradian.imaging.iterative_options import Iterative
from steradian.imaging.plan import ReconstructionPlan
from steradian.imaging.reconstruct import reconstruct
from steradian.imaging.response import Correction, ElasticFilm, FilmResponse, MeasuredFilm
from steradian.imaging.transforms.windows import Window, kaiser_bessel
from steradian.imaging.volume import Axes, Volume
from steradian.imaging.weights import voronoi_weights

__all__ = [
    "Axes",
    "Conditioning",
    "Correction",
    "Display",
    "ElasticFilm",
    "FilmResponse",
    "Iterative",
    "MeasuredFilm",
    "ReconstructionPlan",
    "Volume",
    "Window",
    "direct_spectrum",
    "kaiser_bessel",
    "reconstruct",
    "rim_weights",
    "spectrum_of",
    "voronoi_weights",
]
