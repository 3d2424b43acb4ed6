"""Geometries of the forward model: padded so that periodic copies of the volume do not reach the record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, floor

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import PADDING
from steradian.imaging import validation as checks
from steradian.imaging.acquisition import AcquisitionGeometry
from steradian.imaging.geometry.depth_extent import Extent
from steradian.imaging.geometry.layers import layer_slices, layered_slices
from steradian.imaging.geometry.reconstruction import ReconstructionGeometry, resolve_geometry
from steradian.imaging.medium import LayerPath
from steradian.imaging.options import ImageGrid
from steradian.imaging.transforms.grid_sizes import fast_multiple, fast_size

_MARGIN = 16
"""Samples of a boundary's field after the last one that the film hears: what is cut off there rings a little."""


@dataclass(frozen=True, slots=True)
class LayerGeometry:
    """Part of the forward model that belongs to one layer of the medium.

    Parameters
    ----------
    geometry
        Volume of the layer below the plane of its first slice, and the field there from the laser pulse on; for the
        layer at the film, the field at the film at the record's times.
    path
        Layers from that one to the film.
    gap
        Distance in m from the layer's upper boundary to that plane, less than a slice.
    slices
        First slice of the layer in the volume, and one past its last.
    """

    geometry: ReconstructionGeometry
    path: LayerPath
    gap: float
    slices: tuple[int, int]


def model_geometry(acquisition: AcquisitionGeometry, grid: ImageGrid) -> ReconstructionGeometry:
    """Return the model's geometry in one medium, padded so that copies of the volume do not reach the record.

    Raises
    ------
    InvalidInput
        Naming the parameter and what is allowed.
    """
    samples, dt = acquisition.samples, acquisition.dt
    step = dt * acquisition.sound_speed
    extent = Extent.of(samples, dt, acquisition.t0)
    whole = (extent.first * step, (extent.end - 1) * step)
    depth = whole if grid.depth is None else checks.depths(grid.depth, extent.end * step)
    deepest = int(np.floor(depth[1] / step + 1e-6)) + 1
    # the mirror image's next copy lies at L − z; its sound comes no earlier than sample L − z
    record = fast_size(deepest + samples + extent.ahead)
    padding = (record - extent.ahead) / samples
    if padding > PADDING.high:
        latest = (PADDING.high - 2) * samples * dt
        allowed = f"at most about {latest:.3g} (s), {PADDING.high - 2:g} times the record's length, for a model"
        raise InvalidInput("t0", acquisition.t0, allowed)
    flat, lateral = _unweighted(acquisition, grid, depth[0])
    # without max_frequency: slices are as far apart as samples
    return resolve_geometry(flat, replace(grid, depth=depth, time_padding=padding, lateral_padding=lateral))


def layered_geometries(
    acquisition: AcquisitionGeometry, grid: ImageGrid
) -> tuple[ReconstructionGeometry, list[LayerGeometry]]:
    """Return the geometry of sensors, record and whole volume, and that of each layer in the depth range.

    Slices are as far apart as samples at the slowest layer's speed.

    Raises
    ------
    InvalidInput
        Naming the parameter and what is allowed.
    """
    medium, samples, dt = acquisition.medium, acquisition.samples, acquisition.dt
    step = dt * medium.slowest
    extent = Extent.of(samples, dt, acquisition.t0)
    first, last = layered_slices(medium, extent, grid.depth, step=step, interval=dt, latest=extent.end * dt)
    film = _film_geometry(acquisition, grid, first * step, (first, last))
    layers = [(path, layer_slices(path, step, first, last)) for path in medium.layer_paths()]
    return film, [
        _layer_geometry(film, extent, path, slices, step, slices[0] * step - path.top)
        for path, slices in layers
        if slices is not None
    ]


def timed_geometries(
    acquisition: AcquisitionGeometry, grid: ImageGrid, slices: tuple[int, int]
) -> tuple[ReconstructionGeometry, list[LayerGeometry]]:
    """Return the geometries of :func:`layered_geometries` for slices at equal times of flight along the normal.

    Slice k has the time of flight k·dt. The number of slices then does not depend on the medium, and the depth step is
    the own c·dt of each layer. The depth axis of the whole volume has no meaning.

    Parameters
    ----------
    acquisition, grid
        As in :func:`layered_geometries`, without a depth range.
    slices
        First slice and one past the last.
    """
    medium, dt = acquisition.medium, acquisition.dt
    extent = Extent.of(acquisition.samples, dt, acquisition.t0)
    film = _film_geometry(acquisition, grid, medium.depth_at(slices[0] * dt), slices)
    found, top = [], 0.0
    for path in medium.layer_paths():
        step = path.sound_speed * dt
        bottom = top + (path.bottom - path.top) / step
        low = max(slices[0], ceil(top - 1e-6))
        high = slices[1] if bottom >= slices[1] else ceil(bottom - 1e-6)
        if low < high:
            found.append(_layer_geometry(film, extent, path, (low, high), step, max(0.0, (low - top) * step)))
        top = bottom
    return film, found


def _film_geometry(
    acquisition: AcquisitionGeometry, grid: ImageGrid, depth: float, slices: tuple[int, int]
) -> ReconstructionGeometry:
    flat, lateral = _unweighted(acquisition, grid, depth)
    return replace(resolve_geometry(flat, replace(grid, depth=None, lateral_padding=lateral)), depth=slices)


def _layer_geometry(
    film: ReconstructionGeometry, extent: Extent, path: LayerPath, slices: tuple[int, int], step: float, gap: float
) -> LayerGeometry:
    """Return the part of a layer; ``gap`` is the distance of its first slice from its upper boundary, in m."""
    low, high = slices
    speed, dt, begins, count, top = path.sound_speed, film.sampling_interval, film.time_zero, film.samples, 0
    if path.overlying:
        earliest = gap / speed + sum((each.thickness or 0.0) / each.sound_speed for each in path.overlying)
        begins, top = 0.0, low
        count = max(_MARGIN, floor(extent.end - earliest / dt) + _MARGIN)
    # as in one medium, no copy at L − z is heard
    points = fast_multiple((high - top) + speed * (max(0.0, begins) + count * dt) / step)
    geometry = replace(
        film, sound_speed=speed, samples=count, time_zero=begins, record=points * step / (speed * dt),
        depth_points=points, depth=(low - top, high - top),
    )  # fmt: skip
    first = film.depth[0]
    return LayerGeometry(geometry, path, gap if path.overlying else 0.0, (low - first, high - first))


def _unweighted(acquisition: AcquisitionGeometry, grid: ImageGrid, depth: float) -> tuple[AcquisitionGeometry, float]:
    """Return the acquisition with equal weights, which play no part in the model, and the lateral padding."""
    positions, _, aperture = checks.resolve_sensors(acquisition.sensors, None, acquisition.aperture)
    positions = checks.check_positions(positions)
    aperture = checks.apertures(aperture, positions.shape[1])
    lateral = grid.lateral_padding
    if lateral is None:
        duration = acquisition.samples * acquisition.dt + max(0.0, acquisition.t0)
        lateral = artefact_free_padding(
            positions, aperture=aperture, duration=duration, sound_speed=acquisition.medium.fastest, depth=depth
        )
    weights = np.full(len(positions), float(np.prod(aperture)) / len(positions))
    return replace(acquisition, sensors=positions, aperture=aperture, weights=weights), lateral


def artefact_free_padding(
    positions: ArrayLike, *, aperture: float | Sequence[float], duration: float, sound_speed: float, depth: float = 0.0
) -> float:
    """Return the lateral padding that excludes sound of the volume's periodic copies from the record.

    Parameters
    ----------
    positions
        Sensors in metres, shape (M, d−1) or (M,).
    aperture
        Side lengths of the volume in metres.
    duration
        Time of the last sample, in s.
    sound_speed
        In m/s; the fastest layer's where the medium has several.
    depth
        Where the volume begins, in m.

    Raises
    ------
    InvalidInput
        If more is needed than a transform takes.
    """
    x: NDArray[np.float64] = np.asarray(positions, np.float64)
    x = x[:, None] if x.ndim == 1 else x
    sides = np.broadcast_to(np.asarray(aperture, np.float64), (x.shape[1],))
    heard = np.sqrt(max(0.0, (sound_speed * duration) ** 2 - depth**2))
    needed = (np.abs(x).max(axis=0) + sides / 2 + heard) / sides
    padding = float(max(1.0, needed.max()))
    if padding > PADDING.high:
        allowed = f"at most {PADDING.high:g}: a shorter record, a wider aperture or modes, or a padding of your own"
        raise InvalidInput("lateral_padding", f"{padding:.3g}, needed against periodic copies", allowed)
    return padding
