"""Slices, slabs and projections of a volume file without loading it."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import DamagedFile, InvalidInput
from steradian.reconstructions.volumes.file import centre_in
from steradian.reconstructions.volumes.grid import VoxelGrid
from steradian.reconstructions.volumes.lazy_array import ChunkedDataset
from steradian.reconstructions.volumes.projections import Axis
from steradian.scans.file.corruption import HDF5_ERRORS


@lru_cache(maxsize=32)
def stored_volume(path: Path, version: str) -> VolumeReader:
    """Open a volume through a cache of open files; ``version`` distinguishes a replaced file."""
    return VolumeReader(path)


class VolumeReader:
    """A volume file, or projections of a volume without it; nothing of either stays open.

    Attributes
    ----------
    lattice
        Of the values.
    centre
        What to add to coordinates for those of the file that the sensors' positions came from, in m.
    levels
        How many coarser copies there are: 1 is of averages over 2 voxels along each axis, 2 over 4, and so on.

    Raises
    ------
    FileNotFoundError
        When there is none.
    DamagedFile
        When it is truncated or of another kind.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            with h5py.File(path, "r") as file:
                about = file["values"].attrs if "values" in file else file.attrs
                names = tuple(str(about["axes"]).split(", "))
                origin, spacing = (tuple(map(float, about[name])) for name in ("origin_m", "spacing_m"))
                names_of_copies = ["values", *(f"levels/{n}" for n in range(1, 1 + len(file.get("levels", ()))))]
                self._copies = [ChunkedDataset(file[name]) for name in names_of_copies if name in file]
                shape = self._copies[0].shape if self._copies else tuple(map(int, about["shape"]))
                self.centre = centre_in(file, len(names))
        except FileNotFoundError:
            raise
        except (OSError, *HDF5_ERRORS) as error:
            raise DamagedFile(f"{path.name} cannot be read as a volume: {error}") from error
        self.lattice, self.levels = VoxelGrid(names, origin, spacing, shape), max(0, len(self._copies) - 1)

    def level(self, level: int) -> ChunkedDataset:
        """Return the values, or a coarser copy of them."""
        return self._copies[level]

    def size(self, axis: Axis) -> int:
        """Return the number of voxels along an axis to project along.

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
        """Return the projection of the whole along an axis; of an image from a line of sensors, ``y``: the image.

        Raises
        ------
        InvalidInput
            When the image has none along it.
        """
        with h5py.File(self.path, "r") as file:
            if f"mip_{axis}" in file:
                return np.asarray(file[f"mip_{axis}"])
            if axis == "y" and len(self.lattice.names) == 2:
                return np.asarray(file["values"])
        raise InvalidInput("axis", axis, "y: an image from a line of sensors has no other")

    def slab_mip(self, axis: Axis, chosen: range) -> NDArray[Any]:
        """Return the brightest value along an axis between two places on it.

        Parameters
        ----------
        chosen
            Voxels along the axis, at least one.
        """
        values, at = self._copies[0], self.lattice.names.index(axis)
        index = [slice(0, size, 1) for size in values.shape]
        index[at] = slice(chosen.start, chosen.stop, chosen.step)
        pieces: Iterator[NDArray[Any]] = (piece.max(axis=at) for piece in values.iter_chunks(tuple(index)))
        if at:
            return np.concatenate(list(pieces))
        brightest: NDArray[Any] = next(pieces)
        for piece in pieces:
            np.maximum(brightest, piece, out=brightest)
        return brightest

    def depth_of_max(self, chosen: range) -> NDArray[np.float32]:
        """Return the depth in metres of the brightest value along z, between two places on it."""
        values, first, step = self._copies[0], self.lattice.origin[-1], self.lattice.spacing[-1]
        index = (*(slice(0, size, 1) for size in values.shape[:2]), slice(chosen.start, chosen.stop, chosen.step))
        places = np.concatenate([piece.argmax(axis=2) for piece in values.iter_chunks(index)])
        return (first + step * (chosen.start + chosen.step * places)).astype(np.float32)

    def max_value(self) -> float:
        """Return the greatest value of all that are finite, -inf if none is."""
        image = self.projection("y")
        return float(image.max(initial=-np.inf, where=np.isfinite(image)))
