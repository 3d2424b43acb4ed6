"""Forward model of a layered medium on slices at equal times of flight along the normal.

The number of slices, and what a restriction to some of them means, then do not depend on speeds and thicknesses.
"""

from __future__ import annotations

from typing import Any

from steradian.imaging import AcquisitionGeometry, ImageGrid
from steradian.imaging.geometry.model import LayerGeometry, timed_geometries
from steradian.imaging.geometry.reconstruction import ReconstructionGeometry
from steradian.imaging.operators import ForwardOperator


class TimedOperator(ForwardOperator):
    """Forward model of a layered medium on slices at equal times of flight.

    Parameters
    ----------
    geometry, grid, options
        As of :class:`steradian.ForwardOperator`, the grid without depths.
    slices
        First slice and one past the last; slice k has the time of flight k·dt.
    """

    def __init__(self, geometry: AcquisitionGeometry, grid: ImageGrid, slices: tuple[int, int], **options: Any) -> None:
        self._slices = slices
        super().__init__(geometry, grid, **options)

    def layer_geometries(
        self, geometry: AcquisitionGeometry, grid: ImageGrid
    ) -> tuple[ReconstructionGeometry, list[LayerGeometry]]:
        """Return the geometry of the volume, and of each layer."""
        return timed_geometries(geometry, grid, self._slices)
