"""Regions of interest in volumes, and the statistics of the voxels within them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging.volume import Volume

PERCENTILES = (5, 25, 50, 75, 95)
Range = tuple[float, float]


@dataclass(frozen=True)
class RegionOfInterest(ABC):
    """Region of a volume, by a name and a rule for its voxels.

    Parameters
    ----------
    name
        Text by which tables call it.
    """

    name: str

    @abstractmethod
    def contains(self, volume: Volume) -> NDArray[np.bool_]:
        """Return a boolean array of the volume's shape: voxels whose centres lie in the region.

        Raises
        ------
        InvalidInput
            If the region does not fit the volume's axes.
        """


@dataclass(frozen=True)
class Box(RegionOfInterest):
    """Box between coordinates, ends included.

    Parameters
    ----------
    ranges
        First and last coordinate in m along each axis of the volume, in its order.
    """

    ranges: tuple[Range, ...]

    def contains(self, volume: Volume) -> NDArray[np.bool_]:
        """Return the voxels with centres within all ranges."""
        _check_axes(self.name, len(self.ranges), volume)
        inside = np.ones(volume.values.shape, bool)
        for line, (low, high) in zip(_grids(volume), self.ranges, strict=True):
            if not low <= high:
                raise InvalidInput(self.name, f"{low:g} to {high:g} m", "a rising range")
            inside &= (line >= low) & (line <= high)
        return inside


@dataclass(frozen=True)
class Ellipsoid(RegionOfInterest):
    """Ellipsoid with axes along those of the volume.

    Parameters
    ----------
    centre, radii
        In m along each axis of the volume, in its order.
    """

    centre: tuple[float, ...]
    radii: tuple[float, ...]

    def contains(self, volume: Volume) -> NDArray[np.bool_]:
        """Return the voxels with centres within the ellipsoid."""
        _check_axes(self.name, len(self.centre), volume)
        if len(self.radii) != len(self.centre) or not min(self.radii) > 0:
            raise InvalidInput(self.name, f"radii {self.radii}", f"{len(self.centre)} lengths above 0 m")
        squares = [
            ((line - middle) / radius) ** 2
            for line, middle, radius in zip(_grids(volume), self.centre, self.radii, strict=True)
        ]
        return np.asarray(sum(squares) <= 1)


@dataclass(frozen=True)
class Polygon(RegionOfInterest):
    """Polygon on slices perpendicular to an axis, over a range along that axis.

    Parameters
    ----------
    axis
        Axis that the slices are perpendicular to: "x", "y" or "z".
    corners
        Coordinates in m along the two other axes, in the volume's order, shape (n, 2); n at least 3.
    along
        First and last coordinate in m along ``axis``.
    """

    axis: str
    corners: tuple[tuple[float, float], ...]
    along: Range

    def contains(self, volume: Volume) -> NDArray[np.bool_]:
        """Return the voxels with centres inside the polygon (even-odd rule) and the range."""
        if volume.dimensions != 3 or self.axis not in volume.names:
            raise InvalidInput(
                self.name, f"axis {self.axis}", f"one of {', '.join(volume.names)} of a volume [x, y, z]"
            )
        if len(self.corners) < 3:
            raise InvalidInput(self.name, f"{len(self.corners)} corners", "at least 3")
        across, up = (volume.coordinates(name) for name in volume.names if name != self.axis)
        flat = _inside(np.asarray(self.corners, np.float64), across[:, None], up[None, :])
        line = volume.coordinates(self.axis)
        within = (line >= self.along[0]) & (line <= self.along[1])
        at = volume.names.index(self.axis)
        shape = [-1 if other == at else 1 for other in range(3)]
        return np.asarray(np.expand_dims(flat, at) & within.reshape(shape))


@dataclass(frozen=True)
class AboveThreshold(RegionOfInterest):
    """Voxels of another region whose values are at least a share of that region's maximum.

    Parameters
    ----------
    within
        Region that is searched.
    share
        Share of its maximum, 0 to 1.
    """

    within: RegionOfInterest
    share: float

    def contains(self, volume: Volume) -> NDArray[np.bool_]:
        """Return the voxels at and above the threshold."""
        if not 0 <= self.share <= 1:
            raise InvalidInput(self.name, self.share, "a share from 0 to 1")
        inside = self.within.contains(volume)
        if not inside.any():
            return inside
        return np.asarray(inside & (volume.values >= self.share * volume.values[inside].max()))


@dataclass(frozen=True)
class RegionStatistics:
    """Statistics of the finite values in a region.

    Parameters
    ----------
    name
        That of the region.
    voxels
        Voxels with finite values.
    size
        Their volume in m³ (m² of a 2-D image).
    mean, deviation, minimum, maximum
        Of the values; the deviation is that of the population.
    percentiles
        By number: 5, 25, 50, 75 and 95.
    contrast_to_noise
        Difference of the means over the background's deviation; None without a background.
    """

    name: str
    voxels: int
    size: float
    mean: float
    deviation: float
    minimum: float
    maximum: float
    percentiles: dict[int, float] = field(default_factory=dict)
    contrast_to_noise: float | None = None

    def row(self) -> dict[str, Any]:
        """Return the statistics as one row of a table."""
        row = {name: value for name, value in vars(self).items() if name != "percentiles"}
        return row | {f"percentile_{number}": value for number, value in self.percentiles.items()}


def region_statistics(
    volume: Volume, regions: Sequence[RegionOfInterest], background: RegionOfInterest | None = None
) -> list[RegionStatistics]:
    """Return the statistics of each region; NaN values, such as voxels without signal, are left out.

    Raises
    ------
    InvalidInput
        If a region has no voxel with a value, or does not fit the volume.
    """
    noise = None if background is None else _values(volume, background)
    found = []
    for region in regions:
        values = _values(volume, region)
        contrast = None
        if noise is not None:
            spread = float(noise.std())
            contrast = float((values.mean() - noise.mean()) / spread) if spread else None
        numbers = dict(zip(PERCENTILES, map(float, np.percentile(values, PERCENTILES)), strict=True))
        found.append(
            RegionStatistics(
                region.name,
                len(values),
                float(len(values) * np.prod(volume.spacing)),
                float(values.mean()),
                float(values.std()),
                float(values.min()),
                float(values.max()),
                numbers,
                contrast,
            )
        )
    return found


def _values(volume: Volume, region: RegionOfInterest) -> NDArray[np.float64]:
    values = np.asarray(volume.values[region.contains(volume)], np.float64)
    values = values[np.isfinite(values)]
    if not len(values):
        raise InvalidInput(region.name, "no voxel with a value", "a region with at least one")
    return values


def _grids(volume: Volume) -> list[NDArray[np.float64]]:
    lines = [volume.coordinates(name) for name in volume.names]
    return [line.reshape([-1 if other == at else 1 for other in range(len(lines))]) for at, line in enumerate(lines)]


def _inside(corners: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which points lie inside a polygon: edges crossed by a ray are counted (even-odd rule)."""
    inside = np.zeros(np.broadcast_shapes(x.shape, y.shape), bool)
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if y0 == y1:
            continue
        crosses = (y0 > y) != (y1 > y)
        inside ^= crosses & (x < (x1 - x0) * (y - y0) / (y1 - y0) + x0)
    return inside


def _check_axes(name: str, count: int, volume: Volume) -> None:
    if count != volume.dimensions:
        raise InvalidInput(name, f"{count} axes", f"{volume.dimensions}: {', '.join(volume.names)}")
