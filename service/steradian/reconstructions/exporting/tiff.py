"""Export of volumes as TIFF hyperstacks of ImageJ: one page for each depth, with voxel size and origin."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.reconstructions.exporting.optional_imports import import_optional
from steradian.reconstructions.exporting.series_source import SeriesExportSource
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
    about, resolution = _about(source)
    _check_size(source, 1)
    with tifffile.TiffWriter(path, imagej=True) as file:
        file.write(
            _pages(source),
            shape=(nz, ny, nx),
            dtype=np.float32,
            resolution=resolution,
            metadata={"axes": "ZYX"} | about,
            photometric="minisblack",
        )


def write_tiff_series(source: SeriesExportSource, path: Path) -> None:
    """Write a series as an ImageJ hyperstack, axes t, z, c, y, x: times and wavelengths as frames and channels.

    Each page has a label of its wavelength and time; ``finterval`` is the time between frames in s where it is even.

    Raises
    ------
    InvalidInput
        As of :func:`write_tiff`.
    """
    tifffile = import_optional("tifffile", "tiff")
    nx, ny, nz = source.first.shape
    about, resolution = _about(source.first)
    _check_size(source.first, len(source.volumes))
    grid = source.grid
    names = [[_label(name, source.frames[n].time) for name, n in zip(source.channel_names, row, strict=True)]
             for row in grid]  # fmt: skip
    about |= {"axes": "TZCYX", "Labels": [name for row in names for _ in range(nz) for name in row]}
    about |= {"Info": json.dumps(source.description()), "mode": "grayscale"}
    if source.interval:
        about["finterval"] = source.interval
    shape = (len(grid), nz, len(grid[0]), ny, nx)
    pages = tifffile.memmap(path, shape=shape, dtype=np.float32, imagej=True, resolution=resolution, metadata=about)
    pages = pages.reshape(shape)  # without the axes of length 1 that tifffile leaves out
    for time, row in enumerate(grid):
        for channel, number in enumerate(row):
            start = 0
            for slab in source.volumes[number].depth_slabs():
                pages[time, start : start + len(slab), channel] = slab
                start += len(slab)
    pages.flush()


def _label(name: str, time: float | None) -> str:
    return name if time is None else f"{name}, {time:.6g} s"


def _about(source: VolumeExportSource) -> tuple[dict[str, Any], tuple[float, float]]:
    """Return ImageJ's metadata of spacing and origin, and the resolution in pixels a micrometre."""
    dx, dy, dz = (1e6 * step for step in source.spacing_xyz)
    x, y, z = (1e6 * place for place in source.origin_xyz)
    about = {"spacing": dz, "unit": "micron", "xorigin": -x / dx, "yorigin": -y / dy, "zorigin": -z / dz}
    return about, (1 / dx, 1 / dy)


def _check_size(source: VolumeExportSource, volumes: int) -> None:
    nx, ny, nz = source.shape
    if nx * ny * nz * volumes * 4 > MOST_BYTES:
        many = f"{volumes} × " if volumes > 1 else ""
        allowed = f"less than 4 GiB in an ImageJ TIFF; take ome-zarr or {'nifti' if many else 'nrrd'}"
        raise InvalidInput("volume", f"{many}{source.shape} voxels", allowed)


def _pages(source: VolumeExportSource) -> Iterator[NDArray[Any]]:
    for slab in source.depth_slabs():
        yield from slab.astype(np.float32)
