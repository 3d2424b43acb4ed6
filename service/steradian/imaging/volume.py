"""The image: a block of initial pressure with its coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from steradian.errors import InvalidInput

RealArray: TypeAlias = NDArray[np.floating[Any]]
"""A float32 or float64 array."""


@dataclass(frozen=True, slots=True)
class Axes:
    """Coordinates of the voxel centres in metres.

    Parameters
    ----------
    x, y
        Lateral coordinates, shape (Nx,) and (Ny,), centred on 0 in the sensor plane. ``y`` is None for 2-D images.
    z
        Depth below the sensor plane, shape (Nz,).
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64] | None
    z: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Volume:
    """A reconstructed image of initial pressure.

    Parameters
    ----------
    values
        Shape (Nx, Ny, Nz), or (Nx, Nz) in 2-D; depth is last and contiguous. Unit of the traces.
    axes
        Coordinates of the voxel centres in metres.
    spacing
        Voxel size in metres, one number an axis of ``values`` in the same order.
    """

    values: RealArray
    axes: Axes
    spacing: tuple[float, ...]

    @property
    def dimensions(self) -> int:
        """2 or 3."""
        return self.values.ndim

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the axes of ``values`` in order: ("x", "y", "z") or ("x", "z")."""
        return ("x", "y", "z") if self.values.ndim == 3 else ("x", "z")

    @property
    def origin(self) -> tuple[float, ...]:
        """Coordinates in metres of voxel 0 of each axis."""
        return tuple(float(self.coordinates(name)[0]) for name in self.names)

    def coordinates(self, name: str) -> NDArray[np.float64]:
        """Coordinates in metres along one axis, by its name.

        Raises
        ------
        InvalidInput
            If the image has no such axis.
        """
        found = {"x": self.axes.x, "y": self.axes.y, "z": self.axes.z}.get(name)
        if found is None:
            raise InvalidInput("axis", name, f"one of {', '.join(self.names)}")
        return found

    def mip(self, axis: Literal["x", "y", "z"] = "z") -> RealArray:
        """Maximum intensity projection along one axis.

        Parameters
        ----------
        axis
            The axis that disappears: "z" of a volume leaves an array [x, y], "x" leaves [y, z], "y" leaves [x, z].

        Returns
        -------
        ndarray
            The remaining axes in the order of ``values``.

        Raises
        ------
        InvalidInput
            If the image has no such axis.
        """
        self.coordinates(axis)
        projected: RealArray = self.values.max(axis=self.names.index(axis))
        return projected
