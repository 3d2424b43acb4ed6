"""Export of volumes as plain HDF5, for MATLAB, Octave and Python.

::

    /           attributes as in a volume file (steradian.reconstructions.volumes.file), which this is too
    values      (Nx, Ny, Nz) f4   attributes: axes, spacing_m, origin_m; compressed with gzip
    x, y, z     (Nx,) (Ny,) (Nz,) f8   centres of the voxels in metres
    spacing_m   (3,) f8           voxel size in metres, in the order x, y, z
    mip_x, …                      projections, as in a volume file

MATLAB and Octave show the axes of ``values`` in the opposite order: (Nz, Ny, Nx).

A series has ``values`` (F, Nx, Ny, Nz), with ``excitation_m`` (F,), 0 where not stated, ``time_s`` (F,), NaN where not
known, ``x``, ``y``, ``z`` and ``spacing_m`` as above.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import h5py
import numpy as np

from steradian._version import __version__
from steradian.reconstructions.exporting.series_source import SeriesExportSource
from steradian.reconstructions.exporting.source import VolumeExportSource
from steradian.reconstructions.volumes.file import attach_dimension_scales, write_axes
from steradian.reconstructions.volumes.pyramid import chunk_shape


def write_hdf5(source: VolumeExportSource, path: Path) -> None:
    """Write a volume as HDF5 with its coordinates as datasets."""
    old = source.values
    with h5py.File(path, "w") as file:
        file.attrs.update({name: said for name, said in old.parent.attrs.items() if name != "centre_m"})
        lines = zip(source.names, source.origin, source.spacing, old.shape, strict=True)
        write_axes(file, {name: first + step * np.arange(count) for name, first, step, count in lines})
        file.create_dataset("spacing_m", data=np.array(source.spacing))
        chunks = chunk_shape(old.shape) or old.shape
        values = file.create_dataset(
            "values", old.shape, old.dtype, chunks=chunks, compression="gzip", compression_opts=1, shuffle=True
        )
        values.attrs.update({name: said for name, said in old.attrs.items() if not name.startswith("DIMENSION_")})
        values.attrs["origin_m"] = np.asarray(source.origin, np.float64)
        for start in range(0, old.shape[0], chunks[0]):
            source.check(start, old.shape[0])
            values[start : start + chunks[0]] = source.read(np.s_[start : start + chunks[0]])
            if source.progress:
                source.progress("planes", min(start + chunks[0], old.shape[0]), old.shape[0])
        for name in ("mip_x", "mip_y", "mip_z"):
            if name in old.parent:
                file.create_dataset(name, data=source.read((), name))
        attach_dimension_scales(file, file)


def write_hdf5_series(source: SeriesExportSource, path: Path) -> None:
    """Write a series as HDF5 with one dataset of all volumes, their wavelengths and times."""
    first = source.first
    shape = first.values.shape
    with h5py.File(path, "w") as file:
        file.attrs.update(
            {
                "format": "steradian-series-values",
                "schema_version": 1,
                "software": f"steradian {__version__}",
                "parameters": first.parameters,
                "provenance": first.provenance,
                "scan_frames": json.dumps([frame.numbers for frame in source.frames]),
                "maps": json.dumps([frame.name for frame in source.frames]),
            }
        )
        lines = zip(first.names, first.origin, first.spacing, shape, strict=True)
        write_axes(file, {name: start + step * np.arange(count) for name, start, step, count in lines})
        file["spacing_m"] = np.array(first.spacing)
        file["excitation_m"] = np.array([frame.excitation for frame in source.frames])
        file["time_s"] = np.array([math.nan if frame.time is None else frame.time for frame in source.frames])
        chunks = chunk_shape(shape) or shape
        values = file.create_dataset(
            "values",
            (len(source.volumes), *shape),
            first.values.dtype,
            chunks=(1, *chunks),
            compression="gzip",
            compression_opts=1,
            shuffle=True,
        )
        values.attrs["axes"] = ", ".join(("frame", *first.names))
        for name, dimension in zip(first.names, list(values.dims)[1:], strict=True):
            dimension.label = name
            dimension.attach_scale(file[name])
        for number, volume in enumerate(source.volumes):
            for start in range(0, shape[0], chunks[0]):
                volume.check(start, shape[0])
                values[number, start : start + chunks[0]] = volume.read(np.s_[start : start + chunks[0]])
                if volume.progress:
                    volume.progress("planes", min(start + chunks[0], shape[0]), shape[0])
