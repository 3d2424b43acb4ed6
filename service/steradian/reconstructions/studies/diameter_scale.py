"""Scales that turn the width of a vessel's image into its diameter: simulated, or for a Gaussian point spread."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging import Volume
from steradian.quality.width import Width, find_width
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.studies.simulated_object import Edge, SimulatedObject, Steps
from steradian.scans.recording import Recording

Array = NDArray[np.float64]
_SHARES = (0.4, 0.6, 0.8, 1.0, 1.2, 1.45)
"""Simulated diameters over the first guess."""
_FWHM = float(np.sqrt(8 * np.log(2)))


@dataclass(frozen=True, eq=False)
class DiameterScale:
    """Widths of the images of uniform cylinders by their diameters.

    Parameters
    ----------
    diameters
        In m, rising from 0, shape (n,).
    widths
        Full widths at half maximum of their images in m, shape (n,), rising.
    """

    diameters: Array
    widths: Array

    @property
    def point_spread(self) -> float:
        """Width of the image of a cylinder without a diameter."""
        return float(self.widths[0])

    def diameter(self, width: float) -> tuple[float | None, float]:
        """Return the diameter whose image is ``width`` wide, and its slope by the width; None beyond the scale."""
        if not self.widths[0] <= width <= self.widths[-1]:
            return None, 0.0
        from scipy.interpolate import PchipInterpolator

        # near 0 the width rises as the square of the diameter: squares make the curve straight there
        curve = PchipInterpolator(np.square(self.widths), np.square(self.diameters))
        squared = float(curve(width**2))
        found = float(np.sqrt(max(squared, 0.0)))
        return found, float(curve(width**2, 1)) * width / max(found, 1e-9)


def gaussian_scale(point_spread: float) -> DiameterScale:
    """Return the scale for an isotropic Gaussian point spread of that full width at half maximum in m."""
    diameters = point_spread * np.concatenate([[0.0], np.geomspace(0.3, 20.0, 25)])
    return DiameterScale(diameters, np.array([_blurred(each, point_spread / _FWHM) for each in diameters]))


def simulated_scale(
    volume: Volume,
    recording: Recording,
    parameters: ReconstructionParameters,
    line: tuple[Array, Array],
    measured: Width,
    *,
    widest: float,
    steps: Steps,
) -> DiameterScale:
    """Return the scale at a place, from cylinders simulated with the sensors and parameters of a scan.

    Parameters
    ----------
    volume, recording, parameters
        The image, its A-lines, and how it was reconstructed.
    line
        Start and end in m of a line across the vessel.
    measured
        Width along it, which the simulated diameters surround.
    widest
        Greatest width in m that the scale has to reach.
    steps
        Counter of the simulated images.

    Raises
    ------
    InvalidInput
        If the image is of several layers.
    Cancelled
        If ``cancelled`` returned true.
    """
    if parameters.medium is not None:
        raise InvalidInput("medium", str(parameters.medium), "one layer, in which the point spread is simulated")
    simulated = SimulatedObject.sampled_along(volume, recording, parameters, line, measured)
    spread = _width_of(simulated, 0.0, measured, steps)
    if spread is None:
        raise InvalidInput("place", "no width of the point spread", "a place where thin vessels have an image")
    guess = float(np.sqrt(max(measured.fwhm**2 - spread**2, (0.5 * spread) ** 2)))
    diameters, widths = [0.0], [spread]
    for share in _SHARES:
        width = _width_of(simulated, share * guess, measured, steps)
        if width is not None and width > widths[-1]:
            diameters.append(share * guess)
            widths.append(width)
    while len(widths) > 1 and widths[-1] < 1.1 * widest and len(widths) < 2 * len(_SHARES):
        width = _width_of(simulated, 1.25 * diameters[-1], measured, steps)
        if width is None or width <= widths[-1]:
            break
        diameters.append(1.25 * diameters[-1])
        widths.append(width)
    return DiameterScale(np.array(diameters), np.array(widths))


def _width_of(simulated: SimulatedObject, diameter: float, measured: Width, steps: Steps) -> float | None:
    edge: Edge = "uniform" if diameter else "Gaussian"
    found = find_width(*simulated.image(edge, diameter, measured.height, steps))
    return None if found is None else found.fwhm


def _blurred(diameter: float, deviation: float) -> float:
    """Return the width across the middle of a disc under a two-dimensional Gaussian, by quadrature."""
    if diameter == 0:
        return deviation * _FWHM
    from scipy.special import erf

    radius = diameter / 2
    x = np.linspace(0.0, radius + 5 * deviation, 500)
    nodes, weights = np.polynomial.legendre.leggauss(48)
    across = radius * nodes
    chord = np.sqrt(radius**2 - across**2)
    through = erf(chord / (np.sqrt(2) * deviation))
    kernel = np.exp(-0.5 * ((x[:, None] - across) / deviation) ** 2) / (np.sqrt(2 * np.pi) * deviation)
    values = kernel @ (radius * weights * through)
    below = int(np.flatnonzero(values < values[0] / 2)[0])
    share = (values[below - 1] - values[0] / 2) / (values[below - 1] - values[below])
    return 2 * float(x[below - 1] + share * (x[1] - x[0]))
