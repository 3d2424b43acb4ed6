"""Width (FWHM) of an object in an image, with point spread and corrected diameter.

The image of a vessel is wider than the vessel by the mask's own point spread, and narrower or wider by the limited
view. Neither adds up in squares, so objects are simulated instead
(:mod:`steradian.reconstructions.studies.simulated_object`): the corrected diameter is that at which the image of a
simulated object is as wide as the measured one. Of a uniform and a Gaussian object that one counts whose image has the
more similar profile.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging import Volume
from steradian.quality.profiles import Profile, profile
from steradian.quality.width import Width, find_width
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.scan import Scan
from steradian.reconstructions.studies.simulated_object import EDGES, Edge, SimulatedObject, Steps
from steradian.scans.opening import open_recording
from steradian.scans.recording import Recording

Array = NDArray[np.float64]
Place = Sequence[float]
LEAST_RATIO = 1.1
"""Below so many times the point spread a measured width tells an upper limit of the diameter only."""
_CLOSE = 0.005
_TRIES = 12
_WIDER = 1.3
_COMPARED = 1.5
"""Widths to either side within which profiles are compared."""
_NONE_FITS = "no diameter's image is as wide as this at this place"
_IN_LAYERS = "the image is of a layered or attenuating medium, in which the point spread is not simulated"
_FROM_A_LINE = "the recording is of a line of sensors, of which the point spread is not simulated"


def measure_width(
    volume: Volume,
    scan: Scan | Recording | str | Path,
    start: Place,
    end: Place,
    *,
    parameters: ReconstructionParameters | None = None,
    frame: int | None = 0,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Width:
    """Measure an object's full width at half maximum along a line, and correct it for the scan's point spread.

    Parameters
    ----------
    volume
        The image [x, y, z].
    scan
        The scan it was reconstructed from: for sensors, times, weights.
    start, end
        x, y, z in metres of the ends of a line across the object.
    parameters
        Those of the reconstruction; ``None``: the defaults.
    frame
        Which frame of the scan; None: the only one.
    progress, cancelled
        See :mod:`steradian.core.progress`.

    Returns
    -------
    Width
        Lengths in metres; ``centre``, ``left`` and ``right`` are distances from ``start``.

    Raises
    ------
    InvalidInput
        When the line leaves the volume, or the profile does not fall to a half on both sides of its peak.
    Cancelled
        When ``cancelled`` said so.
    """
    line = _checked_line(volume, start, end)
    found = profile(volume, *line)
    measured = find_width(*found)
    if measured is None:
        raise InvalidInput("end", tuple(end), "the end of a line across one object and its surroundings")
    recording = _recording(scan, frame)
    if volume.dimensions == 2:
        return replace(measured, reason=_FROM_A_LINE)
    chosen = parameters or ReconstructionParameters()
    if chosen.medium is not None:
        return replace(measured, reason=_IN_LAYERS)
    simulated = SimulatedObject.sampled_along(volume, recording, chosen, line, measured)
    return _corrected(simulated, measured, found, Steps(progress, cancelled))


def _checked_line(volume: Volume, start: Place, end: Place) -> tuple[Array, Array]:
    ends = []
    for name, given in (("start", start), ("end", end)):
        place = np.asarray(given, dtype=np.float64)
        if place.shape != (len(volume.names),) or not np.isfinite(place).all():
            raise InvalidInput(name, tuple(given), f"{', '.join(volume.names)} in metres")
        for axis, value in zip(volume.names, place, strict=True):
            at = volume.coordinates(axis)
            if not at[0] - 1e-9 <= value <= at[-1] + 1e-9:
                raise InvalidInput(f"{name}.{axis}", value, f"{at[0]:.6g} to {at[-1]:.6g} m")
        ends.append(place)
    if np.allclose(ends[0], ends[1], rtol=0, atol=1e-9):
        raise InvalidInput("end", tuple(end), "another place than start")
    return ends[0], ends[1]


def _recording(scan: Scan | Recording | str | Path, frame: int | None) -> Recording:
    if isinstance(scan, Recording):
        return scan
    return scan.recording(frame) if isinstance(scan, Scan) else open_recording(Path(scan), frame or 0)


def _corrected(simulated: SimulatedObject, measured: Width, found: Profile, steps: Steps) -> Width:
    """Return the measured width completed by the point spread and the diameter of the best simulated object.

    An iterative image of a narrow object, hardly more than a voxel wide, tells nothing of the object's edge, and its
    width jumps with the noise. The direct image of the same A-lines tells the edge, and the mean of both diameters is
    nearer to the truth than either.
    """
    about = replace(measured, shape=simulated.shape)
    spread = _spread(simulated, measured, steps)
    if spread is None:
        return replace(about, reason="the point spread at this place has no width of its own")
    about = replace(about, point_spread=spread)
    if measured.fwhm < LEAST_RATIO * spread:
        most = _diameter(simulated, "uniform", LEAST_RATIO * spread, measured.height, spread, steps)
        if most is None:
            return replace(about, reason=_NONE_FITS)
        why = f"the image is not wider than {LEAST_RATIO:g} times the point spread: the diameter is at most at_most"
        return replace(about, at_most=most[0], reason=why)
    other = _direct_fit(simulated, steps)
    fit = _best(simulated, measured, found, spread, EDGES if other is None else (other.edge,), steps)
    if fit is None:
        return replace(about, reason=_NONE_FITS)
    diameter = fit.diameter if other is None else float(np.sqrt(fit.diameter * other.diameter))
    return replace(about, corrected=diameter, shape=f"{fit.edge} {simulated.shape}", reason="")


def _spread(simulated: SimulatedObject, measured: Width, steps: Steps) -> float | None:
    found = find_width(*simulated.image("Gaussian", 0.0, measured.height, steps))
    return None if found is None else found.fwhm


@dataclass(frozen=True, order=True, slots=True)
class _Fit:
    """Best simulated object: diameter and edge profile whose image has the measured width, with residual."""

    unlike: float
    diameter: float
    edge: Edge


def _direct_fit(simulated: SimulatedObject, steps: Steps) -> _Fit | None:
    """Return the fit to the direct image of an iterative one; ``None`` for direct methods or without a fit."""
    direct = simulated.direct()
    if direct is None:
        return None
    found = direct.measured_profile(steps)
    width = find_width(*found)
    spread = None if width is None else _spread(direct, width, steps)
    if width is None or spread is None or width.fwhm < LEAST_RATIO * spread:
        return None
    return _best(direct, width, found, spread, EDGES, steps)


def _best(
    simulated: SimulatedObject, measured: Width, found: Profile, spread: float, edges: tuple[Edge, ...], steps: Steps
) -> _Fit | None:
    fits = []
    for edge in edges:
        solved = _diameter(simulated, edge, measured.fwhm, measured.height, spread, steps)
        if solved is not None:
            fits.append(_Fit(_unlike(found, solved[1], measured), solved[0], edge))
    return min(fits, default=None)


def _diameter(
    simulated: SimulatedObject, edge: Edge, wanted: float, height: float, spread: float, steps: Steps
) -> tuple[float, Profile] | None:
    """Solve for the diameter whose simulated image has the width ``wanted``, by regula falsi (Illinois method).

    Noise is scaled by the image's own height, which the amplitude follows. ``None`` where no diameter fits.
    """
    diameter = float(np.sqrt(max(wanted**2 - spread**2, 0.0))) or wanted / 2
    amplitude, low, high = height, (0.0, spread - wanted), None
    best: tuple[float, Profile] | None = None
    last = 0
    for _ in range(_TRIES):
        image = simulated.image(edge, diameter, amplitude, steps)
        got = find_width(*image)
        if got is None:
            return None
        error, best = got.fwhm - wanted, (diameter, image)
        amplitude *= float(np.clip(height / got.height, 0.5, 2.0))
        if abs(error) < _CLOSE * wanted:
            return best
        if error < 0:
            low, high = (diameter, error), _halved(high, last < 0)
        else:
            high, low = (diameter, error), (low[0], low[1] / 2 if last > 0 else low[1])
        last = -1 if error < 0 else 1
        if high is None:
            diameter *= _WIDER
            continue
        if high[0] - low[0] < _CLOSE * wanted:
            return best
        diameter = low[0] + (high[0] - low[0]) * low[1] / (low[1] - high[1])
    return best if high is not None else None


def _halved(end: tuple[float, float] | None, stays: bool) -> tuple[float, float] | None:
    return (end[0], end[1] / 2) if stays and end is not None else end


def _unlike(one: Profile, other: Profile, measured: Width) -> float:
    """Return the relative residual of fitting one profile by another one times a factor, near the object."""
    near = np.abs(one[0] - measured.centre) < _COMPARED * measured.fwhm
    values, model = one[1][near], np.interp(one[0][near], *other)
    factor = float(values @ model) / max(float(model @ model), 1e-300)
    return float(np.linalg.norm(values - factor * model) / np.linalg.norm(values))
