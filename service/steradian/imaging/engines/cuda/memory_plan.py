"""Device memory plan: sizes of the chunks that fit."""

from __future__ import annotations

from dataclasses import dataclass
from math import prod

import numpy as np

from steradian.core.exceptions import InvalidInput
from steradian.imaging.engines.cuda.device_tables import Axis, Frequencies
from steradian.imaging.transform_tables import TransformTables
from steradian.imaging.transforms.lateral import Stencils

MAX_FREE_FRACTION = 0.9
"""Of the free memory that is taken where nobody says how much: transforms keep some that they do not tell of."""


@dataclass(frozen=True, slots=True)
class MemoryPlan:
    """Bytes of device memory and chunk sizes; with several chunks, modes and images stay on the host.

    Parameters
    ----------
    whole
        No pieces: all is on the device.
    frequencies, orbits, rows, columns
        Of a piece, in the lateral transform, on the way between time and depth (along x), and in the image's two
        passes.
    device_bytes
        What the device has to have.
    memory_bytes, kept_bytes, output_bytes
        What the host has to have, image included; what an image keeps; and the image.
    threads
        One: the device has its own.
    """

    fits_in_one_pass: bool
    frequencies: int
    orbits: int
    rows: int
    columns: int
    device_bytes: int
    memory_bytes: int
    kept_bytes: int
    output_bytes: int
    threads: int = 1


def plan_memory(tables: TransformTables, axes: tuple[Axis, Axis], found: Frequencies, limit: int) -> MemoryPlan:
    """Divide the work into as few chunks as ``limit`` bytes of device memory allow.

    Raises
    ------
    InvalidInput
        If the smallest pieces need more.
    """
    g, lateral = tables.geometry, tables.lateral
    item = np.dtype(tables.dtype).itemsize
    pair = 2 * item
    half = g.depth_points // 2 + 1
    (nx, ny), (gx, gy), (fx, fy) = lateral.modes, lateral.grid, tables.image_modes
    used_x, used_y = (len(axis.used) for axis in axes)
    image, fine = prod(g.shape) * item, fx * fy * g.depth_points * item
    sensors = len(lateral.scale)
    traces = sensors * ((g.samples + tables.time.samples + found.length) * item + found.length * pair)
    entries = sensors * _entries(tables) * 2 * (item + 4)
    fixed = traces + entries + found.count * 16
    # a transform may take as much again to work in, and the image is cut out of a larger one
    between, over_depth = gx * gy * found.count * pair, nx * ny * half * pair
    whole = fixed + 2 * between + 2 * over_depth + 2 * max(over_depth, fx * fy * half * pair) + fine + image
    shown_y = tables.visible_region[1][1]
    host_modes, host_depth = used_x * used_y * found.count * pair, nx * ny * half * pair
    if whole <= limit:
        return MemoryPlan(True, found.count, nx // 2 + 1, nx, shown_y, whole, image, image, image)
    of_frequency = (2 * gx * gy + used_x * used_y) * pair
    of_orbit = 2 * (used_y * found.count + ny * half) * pair
    of_row = (ny + 3 * fy) * half * pair
    of_column = (nx + 3 * fx) * half * pair + 2 * fx * g.depth_points * item
    least = fixed + max(of_frequency, of_orbit, of_row, of_column)
    if least > limit:
        voxels = " × ".join(map(str, g.shape))
        raise InvalidInput(
            "device_memory", limit, f"at least {least} bytes for an image of {voxels} voxels in pieces, {whole} at once"
        )
    left = limit - fixed
    host = max(host_modes + host_depth, host_depth + nx * shown_y * half * pair + image)
    return MemoryPlan(
        False,
        min(found.count, left // of_frequency),
        min(nx // 2 + 1, left // of_orbit),
        min(nx, left // of_row),
        min(shown_y, left // of_column),
        limit,
        host,
        image,
        image,
    )


def _entries(tables: TransformTables) -> int:
    """Return the number of grid points onto which a sensor is spread."""
    sensors = tables.lateral.sensors
    if isinstance(sensors, Stencils):
        return int(sensors.tx.shape[1] * sensors.ty.shape[1])
    return -(-len(sensors.weights) // len(tables.lateral.scale))
