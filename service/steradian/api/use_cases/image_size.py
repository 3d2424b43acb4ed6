"""Size of an image before its reconstruction, from the plan of its scan."""

from __future__ import annotations

import math
from typing import Any

from steradian.api.services import ServiceContainer
from steradian.core.exceptions import InvalidInput
from steradian.imaging.geometry.depth_extent import Extent
from steradian.imaging.medium import Medium
from steradian.reconstructions.medium_parameters import build_medium
from steradian.reconstructions.parameters import ReconstructionParameters, default_modes
from steradian.storage.db.tables import ScanRow


def expected_shape(services: ServiceContainer, scan: ScanRow, parameters: ReconstructionParameters) -> tuple[int, ...]:
    """Return the voxels of an image along its lateral axes (one for a line of sensors, else two) and in depth."""
    modes = parameters.modes or _default_modes(services, scan.mask_id)
    across = 1 if services.masks.is_line(scan.mask_id) else 2
    deep = count_slices(services.plans.get(scan.plan_id).parameters, parameters)
    return (*[modes * parameters.upsampling] * across, deep * parameters.upsampling)


def _default_modes(services: ServiceContainer, mask_id: str) -> int:
    return default_modes(services.masks.default_modes(mask_id), services.masks.get(mask_id).aperture)


def count_slices(plan: dict[str, Any], parameters: ReconstructionParameters) -> int:
    """Return the number of depth slices of an image: one a sample, more for a delayed record or a depth range.

    Only the scan file contains the time zero of the record; known here are the requested delay and depth range.
    """
    samples: int = plan["samples"]
    interval, speed = plan.get("sampling_interval"), parameters.sound_speed or plan.get("sound_speed")
    if not interval or (parameters.medium is None and not speed):
        return samples
    if parameters.medium is not None:
        try:
            medium = build_medium(parameters.medium, speed)
        except InvalidInput as error:
            raise InvalidInput(f"parameters.{error.field}", error.value, error.allowed) from error
        return _layered_slices(samples, interval, medium, parameters)
    if parameters.depth_range is None:
        extent = Extent(samples, parameters.conditioning.delay / interval)
        return max(samples, extent.end - extent.first)
    first, last = parameters.depth_range
    return samples if last is None else max(samples, math.ceil((last - (first or 0.0)) / (interval * speed)) + 1)


def _layered_slices(samples: int, interval: float, medium: Medium, parameters: ReconstructionParameters) -> int:
    """Return the number of depth slices of an image of layers, which are a sample of the slowest layer apart."""
    extent = Extent(samples, parameters.conditioning.delay / interval)
    first, last = parameters.depth_range or (None, None)
    begin = medium.depth_at(extent.first * interval) if first is None else first
    end = medium.depth_at(extent.end * interval) if last is None else last
    return max(samples, math.ceil((end - begin) / (interval * medium.slowest)) + (last is not None))


def least_memory(shape: tuple[int, ...], parameters: ReconstructionParameters) -> int:
    """Return the bytes of the image alone (float32), a lower bound of memory; 0 if its depth is not known yet."""
    is_whole = parameters.depth_range is None and parameters.depth_step is None and parameters.highest_frequency is None
    return 4 * math.prod(shape) if is_whole else 0
