"""Export of volumes as VTKHDF image data, for ParaView and VTK."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from steradian.reconstructions.exporting.source import VolumeExportSource

NAME = "initial_pressure"
SCALARS = "Scalars"
"""What VTK is to take the values for: without it no array is active, and a viewer shows an empty box."""


def write_vtkhdf(source: VolumeExportSource, path: Path) -> None:
    """Write a volume as VTKHDF (version 2.0) in millimetres.

    The format wants its texts as ASCII strings of fixed length and the values as [z, y, x].
    """
    nx, ny, nz = source.shape
    with h5py.File(path, "w") as file:
        group = file.create_group("VTKHDF")
        group.attrs.create("Type", "ImageData", dtype=h5py.string_dtype("ascii", len("ImageData")))
        group.attrs["Version"] = np.array([2, 0], np.int64)
        group.attrs["WholeExtent"] = np.array([0, nx - 1, 0, ny - 1, 0, nz - 1], np.int64)
        group.attrs["Origin"] = 1e3 * np.array(source.origin_xyz)
        group.attrs["Spacing"] = 1e3 * np.array(source.spacing_xyz)
        group.attrs["Direction"] = np.eye(3).reshape(-1)
        points = group.create_group("PointData")
        values = points.create_dataset(
            NAME, (nz, ny, nx), source.dtype, chunks=(1, ny, nx), compression="gzip", compression_opts=1
        )
        values.attrs.create("Attribute", SCALARS, dtype=h5py.string_dtype("ascii", len(SCALARS)))
        start = 0
        for slab in source.depth_slabs():
            values[start : start + len(slab)] = slab
            start += len(slab)
        file.attrs["provenance"], file.attrs["parameters"] = source.provenance, source.parameters
