"""Export of volumes as TIFF hyperstacks of ImageJ: one page for each depth, with voxel size and origin."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.reconstructions.exporting.optional_imports import import_optional
from steradian.reconstructions.exporting.source import VolumeExportSource

MOST_BYTES = (1 << 32) - (1 << 20)


def write_tiff(source: VolumeExportSource, path: Path) -> None:
    """Write a volume as an ImageJ hyperstack in micrometres: pages along z, rows along y, columns along x.

    Raises
    ------
    InvalidInput
        When it is larger than a TIFF can be, or tifffile is not installed.
    """
    tifffile = import_optional("tifffile", "tiff")
    nx, ny, nz = source.shape
    if nx * ny * nz * 4 > MOST_BYTES:
        raise InvalidInput(
            "volume", f"{source.shape} voxels", "less than 4 GiB in an ImageJ TIFF; take ome-zarr or nrrd"
        )
    dx, dy, dz = (1e6 * step for step in source.spacing_xyz)
    x, y, z = (1e6 * place for place in source.origin_xyz)
    about = {"axes": "ZYX", "spacing": dz, "unit": "micron", "xorigin": -x / dx, "yorigin": -y / dy, "zorigin": -z / dz}
    with tifffile.TiffWriter(path, imagej=True) as file:
        file.write(
            _pages(source),
            shape=(nz, ny, nx),
            dtype=np.float32,
            resolution=(1 / dx, 1 / dy),
            metadata=about,
            photometric="minisblack",
        )


def _pages(source: VolumeExportSource) -> Iterator[NDArray[Any]]:
    for slab in source.depth_slabs():
        yield from slab.astype(np.float32)
