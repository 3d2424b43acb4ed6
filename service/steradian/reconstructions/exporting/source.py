"""Reader of volume files for export, which loads the values in slabs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import Cancelled, DamagedFile, NotFound
from steradian.core.progress import CancelCheck, Progress
from steradian.reconstructions.volumes.file import centre_in, check_format, volume_group
from steradian.scans.file.h5py_errors import reraise_as_damaged

SLAB_BYTES = 32 << 20


@dataclass(frozen=True)
class VolumeExportSource:
    """Reader of a volume file that yields the values in slabs for export.

    Parameters
    ----------
    values
        Dataset [x, y, z], or [x, z] from a line of sensors.
    names
        Names of its axes.
    spacing, origin
        Voxel size and coordinates of the first voxel's centre in metres, in the order of ``names``; the coordinates are
        those of the file that the sensors' positions came from.
    parameters, provenance
        JSON texts of how the volume came about.
    """

    values: h5py.Dataset
    names: tuple[str, ...]
    spacing: tuple[float, ...]
    origin: tuple[float, ...]
    parameters: str
    provenance: str
    progress: Progress | None = None
    cancelled: CancelCheck | None = None

    @property
    def dtype(self) -> np.dtype[Any]:
        """Data type of the values, little-endian."""
        kind: np.dtype[Any] = np.dtype(self.values.dtype).newbyteorder("<")
        return kind

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of voxels (Nx, Ny, Nz); a 2-D image has Ny = 1."""
        x, *y, z = self.values.shape
        return x, y[0] if y else 1, z

    @property
    def spacing_xyz(self) -> tuple[float, float, float]:
        """Voxel size in metres along x, y, z; for a 2-D image the size along y equals that along x."""
        x, *y, z = self.spacing
        return x, y[0] if y else x, z

    @property
    def origin_xyz(self) -> tuple[float, float, float]:
        """Position (x, y, z) of the centre of voxel (0, 0, 0) in metres."""
        x, *y, z = self.origin
        return x, y[0] if y else 0.0, z

    def read(self, index: Any, name: str = "values") -> NDArray[Any]:
        """Read a slice of the values, or of another dataset of the file; raises :class:`DamagedFile`."""
        with reraise_as_damaged(self.values.file.filename, "volume"):
            return np.asarray(self.values.parent[name][index])

    def depth_slabs(self) -> Iterator[NDArray[Any]]:
        """Yield the values in slabs of a few depths as [z, y, x] arrays, x fastest, as most image formats need.

        Raises
        ------
        Cancelled
            When the caller's ``cancelled`` said so.
        DamagedFile
            When the values cannot be read.
        """
        nx, ny, nz = self.shape
        step = max(1, SLAB_BYTES // (nx * ny * self.dtype.itemsize))
        deep = self.values.chunks[-1] if self.values.chunks else 1
        step = max(deep, step // deep * deep)  # each chunk is read once
        for start in range(0, nz, step):
            self.check(start, nz)
            block = self.read(np.s_[..., start : start + step])
            yield np.ascontiguousarray(block.reshape(nx, ny, -1).T, self.dtype)
            self.report(min(start + step, nz), nz)

    def check(self, done: int, total: int) -> None:
        """Raise ``Cancelled`` if the caller has cancelled the export."""
        if self.cancelled and self.cancelled():
            raise Cancelled(f"the export was stopped at {done} of {total}")

    def report(self, done: int, total: int) -> None:
        """Report the number of exported depths to the progress callback."""
        if self.progress:
            self.progress("depths", done, total)


@contextmanager
def open_volume(
    path: Path, progress: Progress | None, cancelled: CancelCheck | None, index: int | None = None
) -> Iterator[VolumeExportSource]:
    """Open a volume file, or the volume of a series file with an index, as a :class:`VolumeExportSource`.

    Raises
    ------
    NotFound
        When there is no such file.
    DamagedFile
        When it is truncated or of another kind.
    """
    if not path.is_file():
        raise NotFound("file", str(path))
    with ExitStack() as opened:
        with reraise_as_damaged(path, "volume"):
            file = opened.enter_context(h5py.File(path, "r"))
            check_format(file, path, or_series=True)
            values = volume_group(file, index)["values"]
            spacing, origin = (tuple(map(float, values.attrs[name])) for name in ("spacing_m", "origin_m"))
            names = tuple(str(values.attrs["axes"]).split(", "))
            origin = tuple(first + moved for first, moved in zip(origin, centre_in(file, len(origin)), strict=True))
            parameters, provenance = (str(file.attrs[name]) for name in ("parameters", "provenance"))
            if not len(names) == len(spacing) == len(origin) == len(values.shape) or len(names) not in (2, 3):
                raise DamagedFile(f"{path}: values of shape {values.shape} with axes {names} and spacing {spacing}")
        yield VolumeExportSource(values, names, spacing, origin, parameters, provenance, progress, cancelled)
