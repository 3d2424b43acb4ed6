"""Size of a volume before its reconstruction, and the limit above which confirmation is required."""

from __future__ import annotations

import math

from steradian.core.exceptions import InvalidInput
from steradian.reconstructions.parameters import LARGE, ReconstructionParameters
from steradian.reconstructions.pipeline.resolve import depth_range_of, extent_of, medium_of, modes_of
from steradian.reconstructions.volumes.pyramid import file_size
from steradian.scans.recording import Recording


class LargeVolume(InvalidInput):
    """Error of a volume above the size limit that was not confirmed."""


def expected_shape(recording: Recording, parameters: ReconstructionParameters) -> tuple[int, ...]:
    """Return the number of voxels along each axis, depth last; a frequency limit reduces the number of depths."""
    extent = extent_of(recording, parameters)
    medium, interval = medium_of(recording, parameters), recording.sampling_interval
    slice_ = interval * medium.slowest
    wanted = depth_range_of(recording, parameters)
    if wanted is None:
        ends = (medium.depth_at(index * interval) / slice_ for index in (extent.first, extent.end))
        first, end = (math.ceil(depth - 1e-6) for depth in ends)
        deep = end - first
    else:
        deep = max(1, math.floor(wanted[1] / slice_ + 1e-6) - math.ceil(wanted[0] / slice_ - 1e-6) + 1)
    if parameters.depth_step is not None:
        deep = math.ceil(deep * min(1.0, slice_ / parameters.depth_step))
    across = parameters.upsampling * modes_of(recording, parameters)
    return (*[across] * recording.positions.shape[1], deep)


def require_agreed(recording: Recording, parameters: ReconstructionParameters, count: int = 1) -> None:
    """Raise :class:`LargeVolume` for a file of ``count`` volumes above 1 GB without confirmation.

    Raises
    ------
    LargeVolume
        With its size, its voxels, and what makes it smaller.
    """
    shape = expected_shape(recording, parameters)
    size = count * file_size(shape)
    if size > LARGE:
        modes = modes_of(recording, parameters)
        voxel = 1e6 * recording.aperture / (parameters.upsampling * modes)
        raise LargeVolume(
            "modes",
            modes,
            f"a volume file of at most 1 GB unasked, this one has {1e-9 * size:.3g} GB "
            f"({f'{count} × ' if count > 1 else ''}{' × '.join(map(str, shape))} "
            f"voxels of {voxel:.4g} µm over {1e3 * recording.aperture:.4g} mm); fewer modes, a depth range or consent",
        )
