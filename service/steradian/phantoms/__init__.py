"""Objects with known initial pressure, and the A-lines that they cause.

In three dimensions everything is a set of Gaussian :class:`Balls`, whose pressure has a closed form; in two, an image
whose waves :func:`line_pressure` propagates exactly in wavenumbers. Neither shares code with the reconstruction.
"""

from fabry_perot.simulator.phantoms import Balls, initial_pressure, yarn
from steradian.phantoms.flat import line_pressure
from steradian.phantoms.forward import pressure, sampled
from steradian.phantoms.noise import add_noise
from steradian.phantoms.sensor import angular_response, band_limited
from steradian.phantoms.targets import chart, star
from steradian.phantoms.tree import tree
from steradian.phantoms.vessels import vessels

__all__ = [
    "Balls",
    "add_noise",
    "angular_response",
    "band_limited",
    "chart",
    "initial_pressure",
    "line_pressure",
    "pressure",
    "sampled",
    "star",
    "tree",
    "vessels",
    "yarn",
]
