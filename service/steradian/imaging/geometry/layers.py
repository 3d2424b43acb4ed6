"""Geometries of the layers of a medium: one image per layer, all with the same voxels."""

from __future__ import annotations

from dataclasses import replace
from math import ceil, floor

from steradian.core.exceptions import InvalidInput
from steradian.imaging import validation as checks
from steradian.imaging.acquisition import AcquisitionGeometry
from steradian.imaging.geometry.depth_extent import Extent
from steradian.imaging.geometry.reconstruction import ReconstructionGeometry, resolve_geometry
from steradian.imaging.medium import LayerPath, Medium
from steradian.imaging.options import ImageGrid
from steradian.imaging.transforms.grid_sizes import fast_multiple


def resolve_layers(
    acquisition: AcquisitionGeometry, grid: ImageGrid, max_frequency: object = None
) -> list[ReconstructionGeometry]:
    """Return the geometry of each layer in the image's depth range, from the film downwards; one without layers.

    The depth step is that of the slowest layer. The period along the depth, and with it the record, of each layer is
    as long as holds the record at the layer's speed, and a whole number of depth steps.

    Parameters
    ----------
    acquisition, grid, max_frequency
        As in :func:`.reconstruction.resolve_geometry`.

    Raises
    ------
    InvalidInput
        Naming the parameter and what is allowed.
    """
    medium = acquisition.medium
    if len(medium.layers) == 1:
        return [resolve_geometry(acquisition, grid, max_frequency)]
    base = resolve_geometry(acquisition, replace(grid, depth=None), max_frequency)
    step, dt = base.depth_step, acquisition.dt
    duration = base.record * dt
    extent = Extent.of(acquisition.samples, dt, acquisition.t0)
    latest = (base.record + extent.end - extent.samples - extent.ahead) * dt
    first, last = layered_slices(medium, extent, grid.depth, step=step, interval=dt, latest=latest)
    found = []
    for path in medium.layer_paths():
        slices = layer_slices(path, step, first, last)
        if slices is None:
            continue
        low, high = slices
        speed = path.sound_speed
        points = fast_multiple((max(speed * duration, high * step) + 2 * path.top) / step)
        found.append(
            replace(
                base, sound_speed=speed, record=points * step / (speed * dt), depth_points=points, depth=(low, high),
                path=path,
            )
        )  # fmt: skip
    return found


def layer_slices(path: LayerPath, step: float, first: int, last: int) -> tuple[int, int] | None:
    """Return a layer's first slice and one past its last, of those from ``first`` on below ``last``; None: no slice."""
    low, high = max(first, ceil(path.top / step - 1e-6)), last
    if path.bottom / step < last:
        high = ceil(path.bottom / step - 1e-6)
    return (low, high) if low < high else None


def layered_slices(
    medium: Medium,
    extent: Extent,
    depth: tuple[float, float] | None,
    *,
    step: float,
    interval: float,
    latest: float,
) -> tuple[int, int]:
    """Return first and end index of the depth slices of an image of a layered medium.

    Without a range: from the film, or where the record is late from the depth of its first sample, to that of the last.

    Parameters
    ----------
    medium, extent, depth
        Layers, record, and first and last depth in m or None.
    step, interval
        Distance of slices in m and sampling interval in s.
    latest
        Time in s after the pulse at which the sound of the deepest possible slice arrives.

    Raises
    ------
    InvalidInput
        If the range is beyond what the record tells of, or without a slice.
    """
    if depth is None:
        return ceil(medium.depth_at(extent.first * interval) / step), ceil(
            medium.depth_at(extent.end * interval) / step
        )
    low, high = checks.depths(depth, medium.depth_at(latest))
    first, last = ceil(low / step - 1e-6), floor(high / step + 1e-6) + 1
    if last <= first:
        raise InvalidInput("depth", depth, f"a range with at least one slice (step {step:.4g} m)")
    return first, last
