"""Simulated point-spread function at the point of interest."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput

if TYPE_CHECKING:
    from steradian.masks.mask import Mask

MOST_MODES = 256


@dataclass(frozen=True)
class PointSpread:
    """Simulated point-spread function: image of a Gaussian ball and its widths.

    Attributes
    ----------
    x, z
        (Nx,), (Nz,) coordinates in metres around the ball.
    section
        (Nx, Nz) the image in the plane through the ball, its peak 1.
    peak
        Peak over the ball's true pressure.
    lateral, axial
        Full width at half maximum in metres along x and z.
    true_width
        That of the ball itself.
    background
        Root mean square of the image beyond three widths from the ball, over its peak.
    """

    x: NDArray[np.float64]
    z: NDArray[np.float64]
    section: NDArray[np.float64]
    peak: float
    lateral: float
    axial: float
    true_width: float
    background: float


def point_spread(
    mask: Mask,
    point: tuple[float, float, float] | None = None,
    *,
    width: float = 150e-6,
    sound_speed: float = 1500.0,
    sampling_interval: float | None = None,
    noise: float | None = None,
) -> PointSpread:
    """Simulate and reconstruct a Gaussian ball at the point of interest.

    Parameters
    ----------
    mask
        The mask.
    point
        x, y, z of the ball in metres; ``None`` for the mask's point of interest.
    width
        Full width at half maximum of the ball in metres.
    sound_speed, sampling_interval
        Metres per second, seconds; ``None`` for 8 ns, or a sixteenth of the time that sound takes through a wider ball.
    noise
        Peak of the strongest A-line over the standard deviation of white noise in dB; ``None``: no noise.

    Raises
    ------
    InvalidInput
        When the mask has no point of interest and none is given, or a figure is not positive.
    """
    if point is None:
        if not len(mask.points_of_interest):
            raise InvalidInput("point", "missing", "x, y, z in metres; this mask has no point of interest")
        first = mask.points_of_interest[0]
        point = (float(first[0]), float(first[1]), float(first[2]))
    for name, value in (("point", point[2]), ("width", width), ("sound_speed", sound_speed)):
        if not value > 0:
            raise InvalidInput(name, value, "> 0")
    if sampling_interval is None:
        sampling_interval = max(8e-9, width / sound_speed / 16)
    sigma = width / np.sqrt(8 * np.log(2))
    across = np.linalg.norm(mask.film_positions - np.array(point[:2]), axis=1)
    distance = np.hypot(across, point[2])
    farthest = max(distance.max() + 6 * sigma, point[2] + 10 * width)  # of the sound, and of what is shown
    samples = ceil(farthest / sound_speed / sampling_interval) + 1
    traces = _pressure(distance, sigma, np.arange(samples) * sampling_interval * sound_speed)
    if noise is not None:
        level = float(np.abs(traces).max()) * 10 ** (-noise / 20)
        traces = traces + level * np.random.default_rng(0).standard_normal(traces.shape)
    return _measure(mask, point, width, _image(mask, point, width, traces, sound_speed, sampling_interval))


def _pressure(distance: NDArray[np.float64], sigma: float, way: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the pressure (M, N_t) of a Gaussian ball of peak 1 at distances R, at ``way`` = c·t."""
    out, back = distance[:, None] - way, distance[:, None] + way
    found: NDArray[np.float64] = (
        out * np.exp(-((out / sigma) ** 2) / 2) + back * np.exp(-((back / sigma) ** 2) / 2)
    ) / (2 * distance[:, None])
    return found


@dataclass(frozen=True)
class _Image:
    values: NDArray[np.float64]
    x: NDArray[np.float64]
    z: NDArray[np.float64]


def _image(
    mask: Mask,
    point: tuple[float, float, float],
    width: float,
    traces: NDArray[np.float64],
    sound_speed: float,
    sampling_interval: float,
) -> _Image:
    """Reconstruct the surroundings of the ball, ten widths wide, and return sections through its centre."""
    from steradian.imaging import Acquisition, Compute, ImageGrid, Nufft, reconstruct

    modes = max(16, min(MOST_MODES, round(3 * mask.aperture / width)))
    acquisition = Acquisition(
        traces,
        mask.positions,
        dt=sampling_interval,
        sound_speed=sound_speed,
        aperture=mask.aperture,
        weights=mask.weights,
    )
    grid = ImageGrid(modes, depth=(max(0.0, point[2] - 10 * width), point[2] + 10 * width))
    volume = reconstruct(acquisition, grid, Nufft(tolerance=1e-3), compute=Compute(device="cpu"))
    values = np.asarray(volume.values, dtype=np.float64)
    if not mask.is_line:
        values = values[:, int(np.abs(volume.coordinates("y") - point[1]).argmin())]
    return _Image(values, volume.axes.x, volume.axes.z)


def _measure(mask: Mask, point: tuple[float, float, float], width: float, image: _Image) -> PointSpread:
    near = np.hypot(image.x[:, None] - point[0], image.z - point[2])
    inside = np.where(near < width, image.values, -np.inf)
    i, k = np.unravel_index(int(inside.argmax()), inside.shape)
    peak = float(image.values[i, k])
    shown = np.abs(image.x - point[0]) <= 10 * width
    away = (near > 3 * width) & (near < 10 * width)
    return PointSpread(
        x=image.x[shown],
        z=image.z,
        section=image.values[shown] / peak,
        peak=peak,
        lateral=_half_width(image.x, image.values[:, k], int(i)),
        axial=_half_width(image.z, image.values[i], int(k)),
        true_width=width,
        background=float(np.sqrt((image.values[away] ** 2).mean())) / peak if away.any() else 0.0,
    )


def _half_width(axis: NDArray[np.float64], profile: NDArray[np.float64], top: int) -> float:
    """Return the full width at half maximum of a peak, by linear interpolation."""
    half = profile[top] / 2
    ends = []
    for step in (-1, 1):
        here = top
        while 0 <= here + step < len(profile) and profile[here + step] > half:
            here += step
        beyond = here + step
        if not 0 <= beyond < len(profile):
            return float("nan")
        share = (profile[here] - half) / (profile[here] - profile[beyond])
        ends.append(axis[here] + share * (axis[beyond] - axis[here]))
    return float(ends[1] - ends[0])
