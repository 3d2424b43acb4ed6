"""Validated geometry of a reconstruction: sensors, periods, modes and depths."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import as_finite_float
from steradian.imaging import validation as checks
from steradian.imaging.acquisition import AcquisitionGeometry
from steradian.imaging.geometry.depth_extent import Extent
from steradian.imaging.geometry.sensor_areas import sensor_areas
from steradian.imaging.geometry.sensor_sensitivity import check_sensitivity, inverse_variance_weights
from steradian.imaging.medium import LayerPath
from steradian.imaging.options import ImageGrid
from steradian.imaging.transforms.grid_sizes import fast_multiple, fast_record_length
from steradian.imaging.volume import VoxelAxes

MIN_CYCLES = 2
"""Of the highest frequency in a record."""


@dataclass(frozen=True, slots=True)
class ReconstructionGeometry:
    """Validated geometry of a reconstruction, complete except for the traces; lengths in metres, times in seconds.

    Parameters
    ----------
    positions
        Shape (M, d−1).
    weights
        h_m, shape (M,), those of A-lines as they were recorded where sensors differ in sensitivity.
    aperture, modes
        As asked for, one number a lateral axis.
    period, padded_modes
        X and N of the formula: ``aperture`` and ``modes`` with the lateral padding.
    samples, record
        Samples a trace has, and N_t of the formula: with the padding in time, with as many as lie between the pulse and
        the first sample (the image's period c·N_t·dt then holds all depths that the record tells of, and none folds
        back), and a few more where a large prime factor would make the transform slow.
    sampling_interval, sound_speed, time_zero
        dt, c, and the time of the first sample after the laser pulse.
    highest_frequency
        End of the band in Hz that is used; None: all up to the Nyquist frequency.
    depth_points
        Points N_z that the period c·N_t·dt along the depth is divided into: N_t, or fewer where they hold the band.
    depth
        First depth index and one past the last; index n is the depth n·Δz below the film.
    upsampling
        Image points per mode.
    path
        Layers that the sound crosses, where the medium has several; ``record`` is then not a whole number, so that all
        layers' images have the same depth step.
    """

    positions: NDArray[np.float64]
    weights: NDArray[np.float64]
    aperture: tuple[float, ...]
    modes: tuple[int, ...]
    period: tuple[float, ...]
    padded_modes: tuple[int, ...]
    samples: int
    record: float
    sampling_interval: float
    sound_speed: float
    time_zero: float
    highest_frequency: float | None
    depth_points: int
    depth: tuple[int, int]
    upsampling: int
    path: LayerPath | None = None

    @property
    def depth_step(self) -> float:
        """Depth step Δz in metres: c·dt, times N_t/N_z."""
        return self.sound_speed * self.sampling_interval * self.record / self.depth_points

    @property
    def band(self) -> float:
        """Upper bound of κ, in cycles a record."""
        nyquist = 0.5 * self.record
        if self.highest_frequency is None:
            return nyquist
        return min(nyquist, self.highest_frequency * self.sampling_interval * self.record)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the image, [x, (y,) z]."""
        return (*(n * self.upsampling for n in self.modes), self.depth[1] - self.depth[0])

    @property
    def spacing(self) -> tuple[float, ...]:
        """Voxel size in metres, in the order of :attr:`shape`."""
        return (*(X / n / self.upsampling for X, n in zip(self.aperture, self.modes, strict=True)), self.depth_step)

    def axes(self) -> VoxelAxes:
        """Return voxel coordinates: lateral (i/upsampling − N//2)·X/N of index i, depth n·Δz of index n."""
        lateral = [
            (np.arange(n * self.upsampling, dtype=np.float64) / self.upsampling - n // 2) * (X / n)
            for X, n in zip(self.aperture, self.modes, strict=True)
        ]
        depth = np.arange(*self.depth, dtype=np.float64) * self.depth_step
        return VoxelAxes(lateral[0], lateral[1] if len(lateral) == 2 else None, depth)

    def normalised_positions(self) -> NDArray[np.float64]:
        """Return sensor positions relative to the padded image, in periods [0, 1), shape (M, d−1)."""
        period, count = np.array(self.period), np.array(self.padded_modes)
        places = (self.positions + (count // 2) * period / count) / period
        return np.asarray(places - np.floor(places))


def _weights(
    weights: ArrayLike | Literal["voronoi"] | None,
    sensitivity: ArrayLike | None,
    x: NDArray[np.float64],
    period: tuple[float, ...],
) -> NDArray[np.float64]:
    count = len(x)
    if weights is None or isinstance(weights, str):
        if weights not in (None, "voronoi"):
            raise InvalidInput("weights", weights, "an array, None or 'voronoi' (the areas of the sensors' cells)")
        h = sensor_areas(x, period)
    else:
        given = checks.as_float64("weights", weights, f"one weight a sensor, shape ({count},)")
        h = checks.check_weights(given, x, period)
    return h if sensitivity is None else inverse_variance_weights(h, x, check_sensitivity(sensitivity, count))


def depth_slice_range(
    depth: tuple[float, float] | None, extent: Extent, record: int, points: int, fine: float
) -> tuple[int, int]:
    """Return first and end index of depth slices for ``points`` in a period of ``record`` steps of ``fine`` metres.

    Without a range: from the film, or where the record is late from c·t₀, to the last sample's depth c·(t₀ + N_t·dt).
    """
    if depth is None:
        return -(-extent.first * points // record), -(-extent.end * points // record)
    low, high = checks.depths(depth, (record + extent.end - extent.samples - extent.ahead) * fine)
    step = fine * record / points
    first, last = int(np.ceil(low / step - 1e-6)), min(points, int(np.floor(high / step + 1e-6)) + 1)
    if last <= first:
        raise InvalidInput("depth", depth, f"a range with at least one slice (step {step:.4g} m)")
    return first, last


def check_upper_frequency(value: object, record: int, interval: float, field: str = "max_frequency") -> float | None:
    """Return the validated upper frequency in Hz, at least 2 cycles a record."""
    if value is None:
        return None
    least = MIN_CYCLES / (record * interval)
    allowed = f"a frequency from {least:.4g} Hz, {MIN_CYCLES} cycles a record, or None"
    if isinstance(value, str):
        allowed += '; "signal" is for reconstruct(), which has the A-lines'
    frequency = as_finite_float(field, value, allowed)
    if frequency < least:
        raise InvalidInput(field, value, allowed)
    return frequency


def _depth_points(highest: float | None, depth_step: float | None, record: int, interval: float, speed: float) -> int:
    points = record
    if highest is not None:
        points = min(record, fast_multiple(2 * np.ceil(min(highest * interval * record, record))))
    if depth_step is None:
        return points
    length = record * interval * speed
    allowed = f"{length / record:.4g} (c·dt) to {length:.4g} m, or None"
    step = as_finite_float("depth_step", depth_step, allowed)
    if not length / record * (1 - 1e-6) <= step <= length:
        raise InvalidInput("depth_step", depth_step, allowed)
    return max(points, min(record, int(np.ceil(length / step - 1e-6))))


def resolve_geometry(
    acquisition: AcquisitionGeometry, grid: ImageGrid, max_frequency: object = None
) -> ReconstructionGeometry:
    """Return the validated geometry of an acquisition and an image grid, with defaults filled in.

    Parameters
    ----------
    acquisition, grid
        Sensors (M, d−1) with their timing, and voxels.
    max_frequency
        Upper end of the band in Hz; None: the Nyquist frequency.

    Raises
    ------
    InvalidInput
        Naming the parameter and what is allowed.
    """
    positions, weights, aperture = checks.resolve_sensors(
        acquisition.sensors, acquisition.weights, acquisition.aperture
    )
    x = checks.check_positions(positions)
    axes = x.shape[1]
    period = checks.apertures(aperture, axes)
    number = tuple(checks.check_integer("modes", n, 2) for n in checks.per_axis("modes", grid.modes, axes))
    samples, interval, speed = acquisition.samples, acquisition.dt, acquisition.sound_speed
    extent = 2 * np.abs(x).max(axis=0)
    if not acquisition.wrap and any(e > X * (1 + checks.ROUNDING) for e, X in zip(extent, period, strict=True)):
        needed = ", ".join(f"{e:.6g}" for e in extent)
        raise InvalidInput("aperture", aperture, f"at least the sensors' extent about 0 ({needed} m), or wrap=True")
    padded = tuple(int(np.ceil(n * (grid.lateral_padding or 1.0) - 1e-9)) for n in number)
    extent = Extent.of(samples, interval, acquisition.t0)
    record = fast_record_length(int(np.ceil(samples * grid.time_padding - 1e-9)) + extent.ahead)
    highest = check_upper_frequency(max_frequency, record, interval)
    points = _depth_points(highest, grid.depth_step, record, interval, speed)
    return ReconstructionGeometry(
        positions=x,
        weights=_weights(weights, acquisition.sensitivity, x, period),
        aperture=period,
        modes=number,
        period=tuple(X * p / n for X, p, n in zip(period, padded, number, strict=True)),
        padded_modes=padded,
        samples=samples,
        record=record,
        sampling_interval=interval,
        sound_speed=speed,
        time_zero=acquisition.t0,
        highest_frequency=highest,
        depth_points=points,
        depth=depth_slice_range(grid.depth, extent, record, points, interval * speed),
        upsampling=grid.upsampling,
    )
