"""Phantoms (test objects with known initial pressure) and their simulated A-lines.

In three dimensions everything is a set of Gaussian :class:`Balls`, whose pressure has a closed form; in two, an image
whose waves :func:`propagate_2d` propagates exactly in wavenumbers. Neither shares code with the reconstruction.
"""

from fabry_perot.simulator.phantoms import Balls, initial_pressure, yarn
from steradian.phantoms.film_response import angular_response, band_limited
from steradian.phantoms.forward import pressure, rasterise
from steradian.phantoms.layered import layered_pressure
from steradian.phantoms.noise import add_noise
from steradian.phantoms.sensing_spot import averaged_over_spot
from steradian.phantoms.targets import chart, star
from steradian.phantoms.tree_2d import tree
from steradian.phantoms.vessels import vessels
from steradian.phantoms.waves_2d import propagate_2d

__all__ = [
    "Balls",
    "add_noise",
    "angular_response",
    "averaged_over_spot",
    "band_limited",
    "chart",
    "initial_pressure",
    "layered_pressure",
    "pressure",
    "propagate_2d",
    "rasterise",
    "star",
    "tree",
    "vessels",
    "yarn",
]
