"""Reader of slices, slabs and projections of a volume file without loading the whole volume."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import DamagedFile, InvalidInput
from steradian.reconstructions.volumes.file import centre_in, volume_group
from steradian.reconstructions.volumes.grid import VoxelGrid
from steradian.reconstructions.volumes.lazy_array import ChunkedDataset
from steradian.reconstructions.volumes.projections import Axis
from steradian.scans.file.h5py_errors import HDF5_ERRORS


@lru_cache(maxsize=32)
def stored_volume(path: Path, version: str, index: int | None = None) -> VolumeReader:
    """Return the reader of a volume file from an LRU cache; ``version`` distinguishes a replaced file."""
    return VolumeReader(path, index)


class VolumeReader:
    """Reader of a volume file, a volume of a series file, or projections only; the file is closed between reads.

    Parameters
    ----------
    path
        The file.
    index
        Which volume of a series file, from 0.

    Attributes
    ----------
    lattice
        Voxel grid of the values.
    centre
        Offset in m from these coordinates to those of the file from which the sensor positions were imported.
    levels
        Number of coarser pyramid levels: level 1 averages 2 voxels along each axis, level 2 averages 4, and so on.

    Raises
    ------
    FileNotFoundError
        When there is none.
    DamagedFile
        When it is truncated or of another kind.
    InvalidInput
        When the index does not fit the file.
    """

    def __init__(self, path: Path, index: int | None = None) -> None:
        import h5py

        self.path = path
        try:
            with h5py.File(path, "r") as whole:
                file = volume_group(whole, index)
                self._group = file.name
                about = file["values"].attrs if "values" in file else file.attrs
                names = tuple(str(about["axes"]).split(", "))
                origin, spacing = (tuple(map(float, about[name])) for name in ("origin_m", "spacing_m"))
                names_of_copies = ["values", *(f"levels/{n}" for n in range(1, 1 + len(file.get("levels", ()))))]
                self._copies = [ChunkedDataset(file[name]) for name in names_of_copies if name in file]
                shape = self._copies[0].shape if self._copies else tuple(map(int, about["shape"]))
                self.centre = centre_in(whole, len(names))
        except (FileNotFoundError, InvalidInput):
            raise
        except (OSError, *HDF5_ERRORS) as error:
            raise DamagedFile(f"{path.name} cannot be read as a volume: {error}") from error
        self.lattice, self.levels = VoxelGrid(names, origin, spacing, shape), max(0, len(self._copies) - 1)

    def level(self, level: int) -> ChunkedDataset:
        """Return the dataset of a pyramid level; level 0 is the full resolution."""
        return self._copies[level]

    def size(self, axis: Axis) -> int:
        """Return the number of voxels along an axis; raises for files without a volume to project.

        Raises
        ------
        InvalidInput
            When there are no values to project, or the image is from a line of sensors.
        """
        if not self._copies:
            raise InvalidInput("slab", "a revision", "a complete volume; a revision has projections only")
        if len(self.lattice.names) != 3:
            raise InvalidInput("slab", "an image from a line of sensors", "a volume, which has something to project")
        return self.lattice.shape[self.lattice.names.index(axis)]

    def projection(self, axis: Axis) -> NDArray[Any]:
        """Return the stored maximum-intensity projection along an axis; for a 2-D image, the image itself (``y``).

        Raises
        ------
        InvalidInput
            When the image has none along it.
        """
        import h5py

        with h5py.File(self.path, "r") as whole:
            file = whole[self._group]
            if f"mip_{axis}" in file:
                return np.asarray(file[f"mip_{axis}"])
            if axis == "y" and len(self.lattice.names) == 2:
                return np.asarray(file["values"])
        raise InvalidInput("axis", axis, "y: an image from a line of sensors has no other")

    def slab_mip(self, axis: Axis, chosen: range, within: tuple[slice, ...] | None = None) -> NDArray[Any]:
        """Return the maximum-intensity projection of a slab along an axis.

        Parameters
        ----------
        chosen
            Voxels along the axis, at least one.
        within
            Slice of the voxels along each axis, that of ``axis`` without effect; None: all.
        """
        values, at = self._copies[0], self.lattice.names.index(axis)
        index = list(within or (slice(0, size, 1) for size in values.shape))
        index[at] = slice(chosen.start, chosen.stop, chosen.step)
        pieces: Iterator[NDArray[Any]] = (_maxima(piece, at) for piece in values.iter_chunks(tuple(index)))
        if at:
            return np.concatenate(list(pieces))
        brightest: NDArray[Any] = next(pieces)
        for piece in pieces:
            np.fmax(brightest, piece, out=brightest)
        return brightest

    def depth_of_max(self, chosen: range) -> NDArray[np.float32]:
        """Return the depth map of a slab along z: depth in metres of each column's maximum."""
        values, first, step = self._copies[0], self.lattice.origin[-1], self.lattice.spacing[-1]
        index = (*(slice(0, size, 1) for size in values.shape[:2]), slice(chosen.start, chosen.stop, chosen.step))
        places = np.concatenate([_places_of_maxima(piece) for piece in values.iter_chunks(index)])
        return (first + step * (chosen.start + chosen.step * places)).astype(np.float32)

    def max_value(self) -> float:
        """Return the maximum of all finite values; -inf if there is none."""
        image = self.projection("y")
        return float(image.max(initial=-np.inf, where=np.isfinite(image)))


def _maxima(values: NDArray[Any], axis: int) -> NDArray[Any]:
    """Return the maxima along an axis, without voxels that have no value (NaN)."""
    found: NDArray[Any] = values.max(axis=axis)
    return np.fmax.reduce(values, axis=axis) if np.isnan(found).any() else found


def _places_of_maxima(values: NDArray[Any]) -> NDArray[np.intp]:
    """Return the index of the maximum along z, without voxels that have no value (NaN)."""
    places: NDArray[np.intp] = values.argmax(axis=2)
    if np.isnan(np.take_along_axis(values, places[..., None], axis=2)).any():  # argmax stops at the first NaN
        places = np.where(np.isnan(values), -np.inf, values).argmax(axis=2)
    return places
