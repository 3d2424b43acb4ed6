"""Named measurements in a slice or maximum of a volume: profile with width, region, contrast-to-noise, point.

Widths, profiles and statistics are those of :mod:`steradian.quality`, as in ``steradian measure``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from steradian.core.exceptions import InvalidInput
from steradian.core.validation import Value
from steradian.imaging import Volume, VoxelAxes
from steradian.quality.profiles import Profile, profile
from steradian.quality.region_statistics import Box, RegionStatistics, region_statistics
from steradian.quality.width import find_width
from steradian.reconstructions.volumes.reader import VolumeReader

Coordinate: TypeAlias = Annotated[float, Field(ge=-10, le=10)]
Pair: TypeAlias = Annotated[tuple[Coordinate, ...], Field(min_length=2, max_length=2)]
Point: TypeAlias = tuple[float, float]
Figures: TypeAlias = dict[str, float | None]
MARGIN = 2
"""Voxels beside a line that cubic interpolation reads."""
_NO_WIDTH = "the profile does not fall to a half on both sides of its peak"


class _Measurement(Value):
    """Base class of measurements: name, volume of a series, and plane.

    Positions in the plane are coordinates in metres along the axes of the volume without ``axis``, in the order x, y,
    z. What is measured is the maximum along ``axis`` of the voxels with centres in ``slab``: of one voxel, a slice.
    """

    name: str = Field(min_length=1, max_length=100, description="Name, different from that of other measurements")
    index: int | None = Field(default=None, ge=0, le=2**31, description="Which volume of a series, from 0")
    axis: Literal["x", "y", "z"] = Field(description="Axis across the plane; y for an image from a line of sensors")
    slab: Pair | None = Field(
        default=None,
        description="First and last position along axis, of which the maximum is measured (m); none for an image from "
        "a line of sensors",
    )
    start: Pair = Field(description="Position in the plane of an end, a corner or the point (m)")

    @property
    def places(self) -> list[Point]:
        """Positions in the plane that the measurement spans."""
        names = ("start", "end", "background_start", "background_end")
        return [_point(place) for name in names if (place := getattr(self, name, None)) is not None]


class ProfileMeasurement(_Measurement):
    """Profile along a line, with the full width at half maximum of its highest peak."""

    kind: Literal["profile"] = "profile"
    end: Pair = Field(description="Position of the line's other end (m)")


class RegionMeasurement(_Measurement):
    """Statistics of the voxels in a rectangle."""

    kind: Literal["region"] = "region"
    end: Pair = Field(description="Position of the opposite corner (m)")


class ContrastMeasurement(_Measurement):
    """Contrast-to-noise ratio of a rectangle to another one in the same plane."""

    kind: Literal["contrast"] = "contrast"
    end: Pair = Field(description="Position of the opposite corner (m)")
    background_start: Pair = Field(description="Position of a corner of the background (m)")
    background_end: Pair = Field(description="Position of the background's opposite corner (m)")


class PointMeasurement(_Measurement):
    """Value at a point, interpolated."""

    kind: Literal["point"] = "point"


Measurement: TypeAlias = Annotated[
    ProfileMeasurement | RegionMeasurement | ContrastMeasurement | PointMeasurement, Field(discriminator="kind")
]


@dataclass(frozen=True)
class MeasuredValues:
    """Result of a measurement.

    Parameters
    ----------
    figures
        Numbers by name, lengths in metres. ``value`` is the peak's height above the base, the mean, the
        contrast-to-noise ratio or the value at the point; None where there is none.
    ends
        x, y, z in metres of the ends of a profile in the slice through its peak; () for others.
    reason
        Why there is no value or width; "" where there is one.
    """

    figures: Figures = field(default_factory=dict)
    ends: tuple[tuple[float, ...], ...] = ()
    reason: str = ""


def measure_named(stored: VolumeReader, wanted: Measurement) -> MeasuredValues:
    """Measure in a stored volume, of which only the part around the positions is read.

    Raises
    ------
    InvalidInput
        When the plane or a position is not in the volume, or no voxel with a value lies in a rectangle.
    """
    image = _Image.of(stored, wanted)
    match wanted:
        case ProfileMeasurement():
            return _profile(image, stored, _point(wanted.start), _point(wanted.end))
        case RegionMeasurement():
            found = image.statistics("end", wanted.start, wanted.end)
            names = ("deviation", "minimum", "maximum", "voxels", "size")
            return MeasuredValues({"value": found.mean, **{name: float(getattr(found, name)) for name in names}})
        case ContrastMeasurement():
            return _contrast(image, wanted)
    value = _finite(profile(image.volume, wanted.start, wanted.start))[1]
    if not len(value):
        raise InvalidInput("start", wanted.start, "a position with a value, within the outermost voxel centres")
    return MeasuredValues({"value": float(value[0])})


@dataclass(frozen=True)
class _Image:
    """Part of a slice or maximum of a volume; its two axes stand as x and z of a 2-D volume."""

    volume: Volume
    across: int | None
    """Number of the axis across the plane; None for an image from a line of sensors."""
    slab: range

    @classmethod
    def of(cls, stored: VolumeReader, wanted: Measurement) -> _Image:
        grid = stored.lattice
        flat = len(grid.names) == 2
        if flat and (wanted.axis != "y" or wanted.slab is not None):
            raise InvalidInput("axis", wanted.axis, "y without slab: the image is from a line of sensors")
        if not flat and wanted.slab is None:
            raise InvalidInput("slab", "missing", "first and last position along axis (m), in a volume")
        across = None if flat else grid.names.index(wanted.axis)
        kept = [n for n in range(len(grid.names)) if n != across]
        index = [slice(0, size, 1) for size in grid.shape]
        for n, line in zip(kept, zip(*wanted.places, strict=True), strict=True):
            index[n] = _voxels("start", grid.origin[n], grid.spacing[n], grid.shape[n], line, MARGIN)
        slab = range(1)
        if across is not None:
            ends = wanted.slab or ()
            part = _voxels("slab", grid.origin[across], grid.spacing[across], grid.shape[across], ends, 0)
            slab, index[across] = range(part.start, part.stop), part
        at = grid.slice(tuple(index))
        lines = [at.origin[n] + at.spacing[n] * np.arange(at.shape[n], dtype=np.float64) for n in kept]
        values = stored.level(0).read(tuple(index)) if flat else stored.slab_mip(wanted.axis, slab, tuple(index))
        spacing = tuple(grid.spacing[n] for n in kept)
        return cls(Volume(values, VoxelAxes(lines[0], None, lines[1]), spacing), across, slab)

    def statistics(self, name: str, start: tuple[float, ...], end: tuple[float, ...]) -> RegionStatistics:
        """Return the statistics of a rectangle; ends that are voxel centres are within, but for rounding."""
        edges = [1e-6 * step for step in self.volume.spacing]
        ranges = tuple((min(pair) - edge, max(pair) + edge) for *pair, edge in zip(start, end, edges, strict=True))
        return region_statistics(self.volume, [Box(name, ranges)])[0]


def _profile(image: _Image, stored: VolumeReader, start: Point, end: Point) -> MeasuredValues:
    at, values = _finite(profile(image.volume, start, end))
    measured = find_width(at, values) if len(at) > 2 else None
    if measured is None:
        return MeasuredValues({"value": None, "width": None}, reason=_NO_WIDTH)
    names = ("repeatability", "base", "left", "right")
    figures = {"value": measured.height, "width": measured.fwhm} | {name: getattr(measured, name) for name in names}
    if image.across is None:
        return MeasuredValues(figures)
    peak = float(at[int(values.argmax())]) / float(np.hypot(end[0] - start[0], end[1] - start[1]))
    across = _place_of_maximum(image, stored, [a + peak * (b - a) for a, b in zip(start, end, strict=True)])
    ends = tuple((*place[: image.across], across, *place[image.across :]) for place in (start, end))
    return MeasuredValues(figures, ends)


def _place_of_maximum(image: _Image, stored: VolumeReader, place: list[float]) -> float:
    """Return the coordinate across the plane of the maximum at a position in it."""
    grid, across = stored.lattice, image.across or 0
    index: list[slice | int] = [slice(image.slab.start, image.slab.stop, 1)] * 3
    for n, position in zip((n for n in range(3) if n != image.across), place, strict=True):
        index[n] = int(np.clip(round((position - grid.origin[n]) / grid.spacing[n]), 0, grid.shape[n] - 1))
    column: NDArray[Any] = stored.level(0).read(tuple(index))
    best = int(np.where(np.isnan(column), -np.inf, column).argmax())
    return float(grid.origin[across] + grid.spacing[across] * (image.slab.start + best))


def _contrast(image: _Image, wanted: ContrastMeasurement) -> MeasuredValues:
    inside = image.statistics("end", wanted.start, wanted.end)
    beside = image.statistics("background_end", wanted.background_start, wanted.background_end)
    figures: Figures = {"mean": inside.mean, "background_mean": beside.mean, "background_deviation": beside.deviation}
    if not beside.deviation:
        return MeasuredValues({"value": None, **figures}, reason="the background is constant")
    return MeasuredValues({"value": (inside.mean - beside.mean) / beside.deviation, **figures})


def _voxels(name: str, origin: float, spacing: float, count: int, places: tuple[float, ...], margin: int) -> slice:
    """Return the voxels between positions, and ``margin`` beyond; raises InvalidInput where there are none."""
    low, high = ((end - origin) / spacing for end in (min(places), max(places)))
    first, last = int(np.ceil(low - 1e-6)) - margin, int(np.floor(high + 1e-6)) + margin
    if last < 0 or first > count - 1 or last < first:
        allowed = f"positions from {origin:.6g} to {origin + spacing * (count - 1):.6g} m, with a voxel's centre"
        raise InvalidInput(name, list(places), allowed)
    return slice(max(first, 0), min(last, count - 1) + 1, 1)


def _finite(found: Profile) -> Profile:
    keep = np.isfinite(found[1])
    return found[0][keep], found[1][keep]


def _point(place: tuple[float, ...]) -> Point:
    return place[0], place[1]
