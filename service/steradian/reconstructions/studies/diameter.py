"""Diameter of a vessel in volumes: widths of lines across it, corrected for the image's point spread.

The image of a thin vessel is as wide as the point spread. Vessels are therefore simulated at the same place, with the
sensors and parameters of the scan, and measured widths are read on the scale of their widths. Without the scan, a
stated point spread is taken for a Gaussian one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.core.quantity_ranges import as_finite_float
from steradian.imaging import Volume
from steradian.quality.profiles import profile
from steradian.quality.width import Width, find_width
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.studies.diameter_scale import DiameterScale, gaussian_scale, simulated_scale
from steradian.reconstructions.studies.orientation import direction_at
from steradian.reconstructions.studies.simulated_object import Steps
from steradian.scans.recording import Recording

__all__ = ["VesselDiameter", "VesselLines", "measure_diameter", "measure_diameters"]

Array = NDArray[np.float64]
LEAST_RATIO = 1.1
"""Below so many times the point spread a width gives an upper limit of the diameter only."""
SEARCH = 0.15e-3
"""Distance in m from the stated place within which the vessel's brightest voxel is looked for."""
REACH = 3.0
"""Half length of a line across, in widths."""
WIDEST = 0.8e-3
"""Half length in m of the lines that look for the vessel: wider ones are not measured."""
FEWEST = 3
"""Fewest lines with a width."""


@dataclass(frozen=True)
class VesselDiameter:
    """Diameter of a vessel in one volume; lengths in metres.

    Parameters
    ----------
    diameter
        Diameter of the uniform cylinder whose image is as wide as measured; None where ``reason`` says why.
    standard_error
        Standard error of ``diameter`` (68 %) from the scatter of the lines; None without a diameter.
    fwhm
        Mean full width at half maximum of the lines, as the image shows it.
    point_spread
        Width of the image of a vessel without a width; None where neither the scan nor a width was given.
    at_most
        Largest diameter that fits, where the image is hardly wider than the point spread.
    lines
        Number of lines with a width.
    centre
        x, y, z of the middle line's peak.
    reason
        Reason why there is no ``diameter``; "" where there is one.
    """

    diameter: float | None
    standard_error: float | None
    fwhm: float
    point_spread: float | None
    at_most: float | None
    lines: int
    centre: tuple[float, float, float]
    reason: str = ""


@dataclass(frozen=True, eq=False)
class VesselLines:
    """Lines across a vessel: places along it, and one direction.

    Parameters
    ----------
    centres
        Middles of the lines in m, shape (n, 3).
    across
        Unit vector (3,) of the lines: in the sensors' plane, at a right angle to the vessel.
    half
        Half length in m.
    """

    centres: Array
    across: Array
    half: float

    @classmethod
    def at(cls, volume: Volume, place: ArrayLike, *, length: float = 0.6e-3, count: int = 9) -> VesselLines:
        """Return lines across the vessel at a place of a volume.

        Parameters
        ----------
        volume
            Image [x, y, z].
        place
            x, y, z in m of a point on the vessel, to 0.15 mm.
        length
            Length of the vessel over which the lines are spread, in m, 0 to 20 mm.
        count
            Number of lines, 3 to 200.

        Raises
        ------
        InvalidInput
            If the image is 2-D, a value is out of range, or there is no elongated object.
        """
        if volume.dimensions != 3:
            raise InvalidInput("volume", "an image of a line of sensors", "a volume [x, y, z]")
        if not 0 < as_finite_float("length", length, "above 0, at most 0.02 m") <= 20e-3:
            raise InvalidInput("length", length, "above 0, at most 0.02 m")
        if count != int(count) or not FEWEST <= count <= 200:
            raise InvalidInput("lines", count, f"a whole number from {FEWEST} to 200")
        peak = _mid_depth(volume, _brightest(volume, np.asarray(place, np.float64)), WIDEST)
        width = _narrowest(volume, peak)
        along = None if width is None else direction_at(volume, peak, width)
        if width is None or along is None or np.hypot(along[0], along[1]) < 0.3:
            allowed = "a place on an elongated object that is not upright"
            raise InvalidInput("place", ", ".join(f"{1e3 * each:.4g}" for each in peak) + " mm", allowed)
        across = np.array([-along[1], along[0], 0.0]) / np.hypot(along[0], along[1])
        steps = np.linspace(-length / 2, length / 2, int(count))
        lines = cls(peak + steps[:, None] * along, across, REACH * width)
        return replace(lines, centres=np.array([_mid_depth(volume, each, 2 * width) for each in lines.centres]))

    def widths(self, volume: Volume) -> list[Width]:
        """Return the widths of the lines that cross one object near their middle."""
        found = []
        for centre in self.centres:
            at, values = profile(volume, centre - self.half * self.across, centre + self.half * self.across)
            width = find_width(at, values) if len(at) > 2 else None
            if width is not None and abs(width.centre - self.half) < self.half / REACH:
                found.append(width)
        return found


def measure_diameter(volume: Volume, place: ArrayLike, **options: Any) -> VesselDiameter:
    """Measure the diameter of a vessel in a volume; options and errors as of :func:`measure_diameters`."""
    (found,) = measure_diameters([volume], place, **options)
    return found


def measure_diameters(
    volumes: Sequence[Volume],
    place: ArrayLike,
    *,
    recording: Recording | None = None,
    parameters: ReconstructionParameters | None = None,
    point_spread: float | None = None,
    length: float = 0.6e-3,
    lines: int = 9,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> list[VesselDiameter]:
    """Measure the diameter of a vessel in volumes on the same voxels, such as those of a series.

    The lines lie at a right angle to the vessel in the sensors' plane, at the same places in all volumes: found in
    the first one.

    Parameters
    ----------
    volumes
        Images [x, y, z].
    place
        x, y, z in m of a point on the vessel, to 0.15 mm.
    recording
        A-lines of the first volume (:meth:`steradian.Scan.recording`): vessels are simulated with its sensors.
    parameters
        Those of the reconstruction; None: the defaults.
    point_spread
        Full width at half maximum of the image's point spread in m, taken for Gaussian, instead of the recording.
    length
        Length of the vessel over which the lines are spread, in m, 0 to 20 mm.
    lines
        Number of lines, 3 to 200.
    progress, cancelled
        See :mod:`steradian.core.progress`.

    Raises
    ------
    InvalidInput
        If a value is out of range, or there is no elongated object at the place in the first volume.
    Cancelled
        If ``cancelled`` returned true.
    """
    if recording is not None and point_spread is not None:
        raise InvalidInput("point_spread", point_spread, "None beside a recording, from which it is simulated")
    if point_spread is not None and not 0 < as_finite_float("point_spread", point_spread, "0 to 0.01 m") <= 10e-3:
        raise InvalidInput("point_spread", point_spread, "above 0, at most 0.01 m")
    across = VesselLines.at(volumes[0], place, length=length, count=lines)
    found = [across.widths(volume) for volume in volumes]
    if len(found[0]) < FEWEST:
        raise InvalidInput("place", f"{len(found[0])} lines with a width", f"at least {FEWEST} across one vessel")
    scale: DiameterScale | None = None
    if point_spread is not None:
        scale = gaussian_scale(point_spread)
    elif recording is not None:
        middle = across.centres[len(across.centres) // 2]
        ends = middle - across.half * across.across, middle + across.half * across.across
        means = [float(np.mean([each.fwhm for each in widths])) for widths in found if widths]
        typical = replace(found[0][0], fwhm=float(np.median(means)), centre=across.half)
        chosen = parameters or ReconstructionParameters()
        steps = Steps(progress, cancelled)
        scale = simulated_scale(volumes[0], recording, chosen, ends, typical, widest=max(means), steps=steps)
    x, y, z = map(float, across.centres[len(across.centres) // 2])
    return [_diameter([each.fwhm for each in widths], (x, y, z), scale) for widths in found]


def _diameter(found: list[float], centre: tuple[float, float, float], scale: DiameterScale | None) -> VesselDiameter:
    spread = None if scale is None else scale.point_spread
    mean = float(np.mean(found)) if found else float("nan")
    measured = VesselDiameter(None, None, mean, spread, None, len(found), centre)
    if len(found) < FEWEST:
        return replace(measured, reason=f"{len(found)} lines with a width; at least {FEWEST} are needed")
    if scale is None:
        return replace(measured, reason="neither the scan nor a point spread was given")
    if mean < LEAST_RATIO * scale.point_spread:
        most, _ = scale.diameter(LEAST_RATIO * scale.point_spread)
        reason = f"the image is not wider than {LEAST_RATIO:g} times the point spread: the diameter is at most at_most"
        return replace(measured, at_most=most, reason=reason)
    diameter, slope = scale.diameter(mean)
    if diameter is None:
        return replace(measured, reason="no diameter's image is as wide as this at this place")
    error = slope * float(np.std(found, ddof=1) / np.sqrt(len(found)))
    return replace(measured, diameter=diameter, standard_error=error)


def _brightest(volume: Volume, place: Array) -> Array:
    """Return the centre of the brightest voxel near a place."""
    if place.shape != (3,) or not np.isfinite(place).all():
        raise InvalidInput("place", str(place), "x, y, z in metres")
    cut, low = [], []
    for name, value in zip(volume.names, place, strict=True):
        line = volume.coordinates(name)
        if not line[0] - SEARCH <= value <= line[-1] + SEARCH:
            raise InvalidInput(f"place.{name}", float(value), f"{line[0]:.6g} to {line[-1]:.6g} m")
        first, last = np.searchsorted(line, [value - SEARCH, value + SEARCH])
        first = min(int(first), len(line) - 1)
        cut.append(slice(first, max(int(last), first + 1)))
        low.append(first)
    values = volume.values[tuple(cut)]
    at = np.unravel_index(int(np.argmax(values)), values.shape)
    return np.array(
        [volume.coordinates(name)[start + n] for name, start, n in zip(volume.names, low, at, strict=True)], np.float64
    )


def _mid_depth(volume: Volume, place: Array, reach: float) -> Array:
    """Return a place moved to the middle between the half maxima along the depth around it, if there are any."""
    low, high = max(volume.axes.z[0], place[2] - reach), min(volume.axes.z[-1], place[2] + reach)
    start = np.array([*place[:2], low])
    at, values = profile(volume, start, np.array([*place[:2], high]))
    found = find_width(at, values, 0.0) if len(at) > 2 else None
    step = volume.spacing[2]
    if found is None or not found.left - step <= place[2] - low <= found.right + step:
        return place
    return np.array([*place[:2], low + found.centre])


def _narrowest(volume: Volume, peak: Array) -> float | None:
    """Return the least width of lines through a place in the sensors' plane; None where no line has one."""
    found = []
    for angle in np.linspace(0, np.pi, 8, endpoint=False):
        way = WIDEST * np.array([np.cos(angle), np.sin(angle), 0.0])
        at, values = profile(volume, peak - way, peak + way)
        width = find_width(at, values) if len(at) > 2 else None
        if width is not None and width.left <= WIDEST <= width.right:
            found.append(width.fwhm)
    return min(found, default=None)
