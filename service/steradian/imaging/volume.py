"""Volume: reconstructed image of initial pressure with its coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.drawing import display_dispatch

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes as Plot

RealArray: TypeAlias = NDArray[np.floating[Any]]
"""A float32 or float64 array."""


@dataclass(frozen=True, slots=True)
class VoxelAxes:
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


@dataclass(frozen=True, slots=True)
class ReconstructionInfo:
    """Metadata of a finished reconstruction: method, device, band and, if iterative, convergence.

    Parameters
    ----------
    method
        Name of the method used: "nedner", "ner", "linear", "nearest", "interpolated" or "iterative".
    device
        "cpu", or the name of the GPU.
    notes
        Reasons why the device is not the requested one, or computed in pieces.
    max_frequency
        Upper end in Hz of the band that was used; None: the Nyquist frequency.
    iterations
        Iterations done; 0 for a direct method.
    stop_reason
        Criterion that ended the iterations: "discrepancy", "change", "misfit" (a step reduced it too little) or
        "iterations"; "" for a direct method.
    residuals
        Misfit ‖A f − g‖/‖g‖ at the start of each iteration, and with thresholding at the end; () for a direct method.
    products
        Products with A and with Aᵀ, or direct reconstructions, in all: the unit of an iterative method's cost.
    decimation
        Samples of the traces that one sample of an iterative method's model represents.
    memory_bytes
        Upper bound of the memory that was allocated, image included.
    noise_gain
        Pairs of a depth in m and the amplification of the A-lines' noise there by the compensation of attenuation; ()
        without one.
    """

    method: str
    device: str = "cpu"
    notes: tuple[str, ...] = ()
    max_frequency: float | None = None
    iterations: int = 0
    stop_reason: Literal["discrepancy", "change", "misfit", "iterations", ""] = ""
    residuals: tuple[float, ...] = ()
    products: int = 0
    decimation: int = 1
    memory_bytes: int = 0
    noise_gain: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Volume:
    """Reconstructed image of initial pressure with coordinates and metadata.

    Parameters
    ----------
    values
        Shape (Nx, Ny, Nz), or (Nx, Nz) in 2-D; depth is last and contiguous. Unit of the traces.
    axes
        Coordinates of the voxel centres in metres.
    spacing
        Voxel size in metres, one number an axis of ``values`` in the same order.
    sound_speed
        Speed of sound in m/s that it was reconstructed with; None where it was not reconstructed.
    info
        Method, device, band and convergence of the reconstruction; None for volumes from other sources, files included.
    """

    values: RealArray
    axes: VoxelAxes
    spacing: tuple[float, ...]
    sound_speed: float | None = None
    info: ReconstructionInfo | None = None

    @property
    def dimensions(self) -> int:
        """Number of dimensions: 2 or 3."""
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
        """Return the voxel coordinates in metres along a named axis.

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
        """Return the maximum-intensity projection along one axis.

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

    def __repr__(self) -> str:
        voxels, size = (" × ".join(each) for each in (map(str, self.values.shape), self._steps()))
        ends = [f"{name} {1e3 * line[0]:.4g} to {1e3 * line[-1]:.4g}" for name, line in self._lines()]
        amount = f"{self.values.dtype}, {self.values.nbytes / 1e6:.3g} MB"
        return f"<Volume: {voxels} voxels of {size} µm, {', '.join(ends)} mm, {amount}>"

    def _steps(self) -> list[str]:
        return [f"{1e6 * step:.4g}" for step in self.spacing]

    def _lines(self) -> list[tuple[str, NDArray[np.float64]]]:
        return [(name, self.coordinates(name)) for name in self.names]

    def _repr_html_(self) -> str:
        return display_dispatch.to_html(self)

    def plot(
        self,
        axis: Literal["x", "y", "z"] = "z",
        axes: Plot | None = None,
        *,
        cmap: str = "inferno",
        vmin: float | None = None,
        vmax: float | None = None,
        scale_bar: float | bool = False,
    ) -> Plot:
        """Plot the maximum-intensity projection along one axis; a 2-D image as it is.

        Parameters
        ----------
        axis
            The axis that disappears.
        axes
            A matplotlib plot to draw into; None: a new one.
        cmap
            A colour map of matplotlib, or a single colour: red, green, blue, cyan, magenta, yellow.
        vmin, vmax
            Values at the ends of the colours; None: 0 and the 99.9th percentile, at least half the maximum.
        scale_bar
            Length of a scale bar in mm; True: a round one; False: none.

        Raises
        ------
        InvalidInput
            If the image has no such axis, there is no such colour map, or ``vmax`` is not above ``vmin``.
        """
        options = {"axis": axis, "cmap": cmap, "vmin": vmin, "vmax": vmax, "scale_bar": scale_bar}
        return display_dispatch.plot(self, axes, **options)

    def figure(self, path: str | Path, **options: Any) -> Path:
        """Write a figure for a paper to a ``.pdf``, ``.svg`` or ``.png`` file: a projection with axes and colour bar.

        Parameters
        ----------
        path
            File to write.
        **options
            ``axis`` that disappears ("z"), or several for a panel of each; ``slab``, first and last position in m
            along it, by axis for several (None: all), and ``region``, such positions by axis, of what is shown;
            ``width`` in mm (85), ``dpi`` (300), ``font_size`` in points (7), ``scale_bar`` in mm (None: round, 0:
            none), ``interpolation`` ("nearest" or "linear"); ``depth_coded`` (False), ``colour_map`` ("inferno" and
            others of matplotlib, or a single colour), ``percentile`` (99.9) or ``limits`` of the scale, ``gamma`` (1)
            or ``log_range_db`` (None), ``label`` of the colour bar, ``near_field`` in m (0), ``name``, the title.

        Raises
        ------
        InvalidInput
            When the ending is another one, or a value is out of range.
        """
        return display_dispatch.figure(self, Path(path), **options)

    def to_xarray(self) -> xarray.DataArray:
        """Return the image as xarray DataArray: dimensions x, y and z, or x and z, coordinates in metres.

        The values are shared, not copied. ``units`` and ``long_name`` are where xarray's plots look for them; the
        speed of sound is the attribute ``sound_speed_m_s``, if it is known.

        Raises
        ------
        ImportError
            When xarray is not installed; the extra ``notebook`` has it.
        """
        try:
            import xarray
        except ImportError as error:
            raise ImportError("to_xarray needs xarray, which pip install 'steradian[notebook]' installs") from error
        words = {"x": "x", "y": "y", "z": "depth"}
        about = {} if self.sound_speed is None else {"sound_speed_m_s": self.sound_speed}
        return xarray.DataArray(
            self.values,
            {name: (name, line, {"units": "m", "long_name": words[name]}) for name, line in self._lines()},
            self.names,
            "initial_pressure",
            {"long_name": "initial pressure", "units": "arb. u.", **about},
        )

    def save(self, path: str | Path) -> None:
        """Write the volume into a file by an atomic write; the suffix determines the format.

        ``.h5`` (docs/volume-file.md), which :func:`steradian.open` reads; ``.nii``, ``.nii.gz``, ``.nrrd``,
        ``.vtkhdf``, ``.tif`` and ``.zarr`` for other programs; ``.png``: the z-projection.

        Raises
        ------
        InvalidInput
            When the ending is another one, or the format cannot hold the volume.
        Conflict
            When there is a folder of that name.
        """
        display_dispatch.save(self, Path(path))
