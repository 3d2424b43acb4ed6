"""Blob detection that proposes points of interest in the image of a survey.

Images from few sensors are full of dots below the sensors (near field) and of streaks around an object. So the squared
image is smoothed, the near field is left out, and each depth's own background and its spread are the measure of what
stands out. Better than the square is the product of the images of two halves of the sensors: an object is in both,
dots and streaks of one half are not in the other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.imaging import Volume
from steradian.quality.regions import same_shape

Choice = Literal["brightest", "nearest", "several"]
Array = NDArray[np.float64]
MAX_COUNT = 8
LEAST_SIGNAL_TO_NOISE = 18.0
"""By halves noise alone reached 14 in images of 120 sensors, 10 in those of 200; most objects have 50 to 700."""
SIGMA = 0.45e-3
"""Standard deviation in metres of the smoothing: an object of parts is one blob."""
CENTROID_RADIUS, CENTROID_ROUNDS = 1.2e-3, 3
"""A blob's place is the centroid of what stands out of the background within that radius in metres, found by mean
shift."""
BLOCK = 0.1e-3
"""Greatest side in metres of the blocks that the squared image is averaged over first."""
MIN_SEPARATION = 1.5e-3
"""Least distance in metres of two points of interest."""
MIN_AMPLITUDE_RATIO = 0.3
"""Blobs with less than this part of the brightest one's amplitude are its side lobes as likely as not."""
NEAR_FIELD_RATIO = 0.7
"""The near field ends where median over root mean square of a depth's magnitudes is this part of the usual one: above
it the image consists of dots and of nearly nothing between them."""
PATCHES = 8
"""Patches of a depth along each lateral axis, whose median power counts: an object in few of them does not."""
LOW_QUANTILE, MAX_BACKGROUND_RATIO = 0.2, 3.0
"""A depth's background counts up to so many times the low quantile of all depths: an object that fills its depth is
no background."""
QUANTILE_STRIDE = 5


@dataclass(frozen=True)
class FoundPoint:
    """Point of interest found in an image.

    Attributes
    ----------
    position
        x, y and depth in metres.
    amplitude
        Greatest magnitude of the image there, in its unit.
    signal_to_noise
        Power of the smoothed image over the background of that depth, in standard deviations of that background.
    """

    position: tuple[float, float, float]
    amplitude: float
    signal_to_noise: float


def find_points_of_interest(
    volume: Volume,
    *,
    choice: Choice = "brightest",
    count: int = 1,
    least_signal_to_noise: float = LEAST_SIGNAL_TO_NOISE,
    depth: tuple[float, float] | None = None,
    halves: tuple[Volume, Volume] | None = None,
) -> list[FoundPoint]:
    """Find points of interest by blob detection with non-maximum suppression.

    Parameters
    ----------
    volume
        Image of a survey.
    choice
        ``brightest``; ``nearest``: of least depth; ``several``: up to ``count``, the most significant first, at least
        1.5 mm apart.
    count
        Greatest number of points with ``several``, 1 to 8.
    least_signal_to_noise
        Least :attr:`FoundPoint.signal_to_noise`.
    depth
        First and last depth in metres to search; ``None``: all beyond the near field.
    halves
        Images of two halves of the sensors, with the voxels of ``volume``; their product then replaces its square.

    Returns
    -------
    list of FoundPoint
        Empty where nothing stands out of the background.

    Raises
    ------
    InvalidInput
        When the image is 2-D, a half has other voxels, or a parameter is out of range.
    """
    _check(volume, choice, count, least_signal_to_noise, depth)
    for name, half in zip(("halves.0", "halves.1"), halves or (), strict=False):
        same_shape(name, half.values, volume.values.shape, "volume")
    one, other = (half.values for half in halves) if halves else (volume.values, volume.values)
    axes = _block_axes(volume)
    sharp = _block_means(one, other, volume.spacing)
    beyond = axes[2] >= _near_field_end(volume)
    allowed = beyond if depth is None else (axes[2] >= depth[0]) & (axes[2] <= depth[1])
    power = _smooth(np.where(beyond | allowed, sharp, 0.0), axes)
    if not allowed.any() or not (power > 0).any():
        return []
    significance, excess = _significance(power, allowed)
    peaks = _peaks(power, significance, least_signal_to_noise)
    found = [_describe(volume, _centroid(excess, axes, peak), float(significance[peak])) for peak in peaks]
    found = _suppress(found, [float(power[peak]) for peak in peaks])
    if choice == "nearest":
        found.sort(key=lambda point: point.position[2])
    elif choice == "several":
        found.sort(key=lambda point: -point.signal_to_noise)
        return found[:count]
    return found[:1]


def mean_image(halves: tuple[Volume, Volume]) -> Volume:
    """Return the mean of the images of two halves of the sensors."""
    return replace(halves[0], values=(halves[0].values + halves[1].values) / 2)


def _check(
    volume: Volume, choice: str, count: int, least_signal_to_noise: float, depth: tuple[float, float] | None
) -> None:
    if volume.dimensions != 3:
        raise InvalidInput("volume", "an image [x, z]", "a volume [x, y, z]")
    if choice not in get_args(Choice):
        raise InvalidInput("choice", choice, ", ".join(get_args(Choice)))
    if not 1 <= count <= MAX_COUNT:
        raise InvalidInput("count", count, f"1 to {MAX_COUNT} (points)")
    if not least_signal_to_noise > 0:
        raise InvalidInput("least_signal_to_noise", least_signal_to_noise, "> 0")
    if depth is not None and not 0 <= depth[0] < depth[1]:
        raise InvalidInput("depth", depth, "0 or more, the first below the last (m)")


def _block_sides(shape: tuple[int, ...], spacing: tuple[float, ...]) -> list[int]:
    return [max(1, min(int(BLOCK / step), size)) for step, size in zip(spacing, shape, strict=True)]


def _block_axes(volume: Volume) -> tuple[Array, Array, Array]:
    """Return the coordinates of the blocks' centres in metres."""
    sides = _block_sides(volume.values.shape, volume.spacing)
    lines = [volume.coordinates(name) for name in "xyz"]
    x, y, z = (
        line[: len(line) // side * side].reshape(-1, side).mean(axis=1) for line, side in zip(lines, sides, strict=True)
    )
    return x, y, z


def _block_means(one: NDArray[Any], other: NDArray[Any], spacing: tuple[float, ...]) -> Array:
    """Return the mean product of two images over blocks of voxels."""
    sides = _block_sides(one.shape, spacing)
    kept = tuple(slice(0, size // side * side) for size, side in zip(one.shape, sides, strict=True))
    mean = np.multiply(one[kept], other[kept], dtype=np.float32)
    for axis, side in enumerate(sides):
        if side > 1:
            mean = np.add.reduceat(mean, np.arange(0, mean.shape[axis], side), axis=axis) / np.float32(side)
    return np.asarray(mean, np.float64)


def _near_field_end(volume: Volume) -> float:
    """Return the depth in metres at which the dots below the sensors have merged into a background."""
    values, z = volume.values, volume.axes.z
    magnitudes = np.abs(values.reshape(-1, len(z))[::QUANTILE_STRIDE])
    strips = [strip for half in np.array_split(values, PATCHES) for strip in np.array_split(half, PATCHES, axis=1)]
    powers = [np.square(strip, dtype=np.float32).mean(axis=(0, 1)) for strip in strips if strip.size]
    mean = np.sqrt(np.median(powers, axis=0))
    ratio = np.median(magnitudes, axis=0) / np.maximum(mean, np.finfo(float).tiny)
    return float(z[int(np.argmax(ratio >= NEAR_FIELD_RATIO * np.median(ratio)))])


def _smooth(power: Array, axes: tuple[Array, Array, Array]) -> Array:
    """Return the Gaussian-smoothed power; beyond the image there is none."""
    from scipy.ndimage import gaussian_filter

    widths = [SIGMA / _step(line) for line in axes]
    return np.asarray(gaussian_filter(power, widths, mode="constant", truncate=3.0), np.float64)


def _significance(smoothed: Array, allowed: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the excess over each depth's median, in units of its upper spread and as it is."""
    lines = smoothed.reshape(-1, smoothed.shape[2])[::QUANTILE_STRIDE]
    middle, upper = np.quantile(lines, [0.5, 0.8413], axis=0)
    spread = upper - middle
    limits = [MAX_BACKGROUND_RATIO * np.quantile(each[allowed], LOW_QUANTILE) for each in (middle, spread)]
    background, unit = np.minimum(middle, max(limits[0], 0.0)), np.minimum(spread, limits[1])
    unit = np.maximum(unit, 1e-9 * float(smoothed.max()))
    excess = np.where(allowed, smoothed - background, 0.0)
    return excess / unit, excess


def _peaks(place: Array, significance: Array, least: float) -> list[tuple[int, int, int]]:
    """Return the significant local maxima among their 26 neighbours, the brightest first."""
    from scipy.ndimage import maximum_filter

    peak = (place == maximum_filter(place, 3, mode="constant")) & (place > 0) & (significance >= least)
    found = [(int(i), int(j), int(k)) for i, j, k in np.argwhere(peak)]
    return sorted(found, key=lambda index: -place[index])


def _centroid(excess: Array, axes: tuple[Array, Array, Array], peak: tuple[int, int, int]) -> Array:
    """Return the centroid x, y, z around a peak by mean shift within a ball, between voxels at its rim."""
    centre = np.array([line[at] for line, at in zip(axes, peak, strict=True)])
    margin = max(map(_step, axes))
    for _ in range(CENTROID_ROUNDS):
        spans = [
            slice(*np.searchsorted(line, [at - CENTROID_RADIUS - margin, at + CENTROID_RADIUS + margin]))
            for line, at in zip(axes, centre, strict=True)
        ]
        grid = np.meshgrid(*(line[span] for line, span in zip(axes, spans, strict=True)), indexing="ij", sparse=True)
        distance = np.sqrt(sum((line - at) ** 2 for line, at in zip(grid, centre, strict=True)))
        inside = np.clip((CENTROID_RADIUS - distance) / margin + 0.5, 0.0, 1.0)
        mass = inside * np.maximum(excess[tuple(spans)], 0.0)
        if not mass.sum() > 0:
            break
        centre = np.array([float((mass * line).sum() / mass.sum()) for line in grid])
    return centre


def _describe(volume: Volume, place: Array, signal_to_noise: float) -> FoundPoint:
    """Return the point of interest at a place with the image's greatest magnitude around it."""
    near = [np.abs(volume.coordinates(name) - centre) <= SIGMA for name, centre in zip("xyz", place, strict=True)]
    around = volume.values[np.ix_(*near)]
    amplitude = float(np.abs(around).max()) if around.size else 0.0
    x, y, z = place.tolist()
    return FoundPoint((x, y, z), amplitude, signal_to_noise)


def _suppress(found: list[FoundPoint], brightness: list[float]) -> list[FoundPoint]:
    """Return points without those near a brighter one and those that are its side lobes by their amplitude."""
    kept: list[FoundPoint] = []
    for point, power in zip(found, brightness, strict=True):
        apart = [np.linalg.norm(np.subtract(point.position, other.position)) for other in kept]
        bright = not kept or sqrt(power / brightness[0]) >= MIN_AMPLITUDE_RATIO
        if bright and min(apart, default=np.inf) >= MIN_SEPARATION:
            kept.append(point)
    return kept


def _step(line: Array) -> float:
    return float(line[1] - line[0]) if len(line) > 1 else 1.0
