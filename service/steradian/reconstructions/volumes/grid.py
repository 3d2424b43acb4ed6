"""Voxel grid (origin, spacing and shape per axis) of a volume, a slice or a pyramid level."""

from __future__ import annotations

from dataclasses import dataclass, replace

from steradian.core.exceptions import InvalidInput
from steradian.reconstructions.volumes.lazy_array import Index


@dataclass(frozen=True)
class VoxelGrid:
    """Voxel grid: name, origin, spacing and number of voxels of each axis.

    Attributes
    ----------
    names
        Of the axes, in order.
    origin, spacing
        Centre of the first voxel, and distance of voxels, along each axis in metres.
    shape
        Number of voxels along each axis.
    """

    names: tuple[str, ...]
    origin: tuple[float, ...]
    spacing: tuple[float, ...]
    shape: tuple[int, ...]

    def downsampled(self, times: int) -> VoxelGrid:
        """Return the grid after averaging ``times`` voxels along each axis."""
        half = (times - 1) / 2
        return VoxelGrid(
            self.names,
            tuple(first + half * step for first, step in zip(self.origin, self.spacing, strict=True)),
            tuple(times * step for step in self.spacing),
            tuple(-(-size // times) for size in self.shape),
        )

    def moved(self, by: tuple[float, ...]) -> VoxelGrid:
        """Return the grid with its coordinates shifted by ``by`` metres along each axis."""
        return replace(self, origin=tuple(first + step for first, step in zip(self.origin, by, strict=True)))

    def project_out(self, name: str) -> VoxelGrid:
        """Return the grid of a projection, without the projected axis."""
        return self.slice(tuple(0 if name == other else slice(None) for other in self.names))

    def slice(self, index: Index) -> VoxelGrid:
        """Return the grid of a slice; axes with an integer index are removed."""
        kept = []
        for at, name, first, step, size in zip(index, self.names, self.origin, self.spacing, self.shape, strict=True):
            if isinstance(at, slice):
                places = range(*at.indices(size))
                kept.append((name, first + places.start * step, step * places.step, len(places)))
        names, origin, spacing, shape = zip(*kept, strict=True) if kept else ((), (), (), ())
        return VoxelGrid(names, origin, spacing, shape)


def in_coarser(index: Index, times: int, field: str) -> Index:
    """Convert an index of the full-resolution volume to the index of the same region in a pyramid level.

    Raises
    ------
    InvalidInput
        When voxels are left out in between, which the copy has averaged.
    """
    found: list[slice | int] = []
    for at in index:
        if isinstance(at, int):
            found.append(at // times)
        elif times > 1 and at.step != 1:
            raise InvalidInput(field, f"steps of {at.step}", "steps of 1 in a coarser copy; level=0 takes any")
        else:
            first = at.start // times
            found.append(slice(first, -(-at.stop // times) if at.stop > at.start else first, at.step))
    return tuple(found)
