"""Export of volumes as NIfTI-1, a format of neuroimaging tools and most viewers."""

from __future__ import annotations

import gzip
import json
import struct
from pathlib import Path
from typing import IO, Any, cast

import numpy as np

from steradian._version import __version__
from steradian.core.exceptions import InvalidInput
from steradian.reconstructions.exporting.optional_imports import import_optional
from steradian.reconstructions.exporting.series_source import SeriesExportSource
from steradian.reconstructions.exporting.source import VolumeExportSource

LONGEST = 32_767
COMMENT = 6
"""Code of a header extension with text."""


def write_nifti(source: VolumeExportSource, path: Path) -> None:
    """Write a volume as NIfTI-1 in millimetres, with the affine from voxel to (right, anterior, superior) = (x, y, z).

    The file is compressed if its name ends in ``.gz``.

    Raises
    ------
    InvalidInput
        When an axis is longer than the format can count, or nibabel is not installed.
    """
    header = _header(source, source.shape)
    header.set_xyzt_units("mm")
    header["descrip"] = f"initial pressure, steradian {__version__}".encode()
    with _opened(path) as file:
        _write_header(file, header, b"\0\0\0\0")
        for slab in source.depth_slabs():
            file.write(slab.tobytes())


def write_nifti_series(source: SeriesExportSource, path: Path) -> None:
    """Write a series as 4-D NIfTI-1 in millimetres and seconds, volumes in the order of measurement.

    The step of the fourth axis is the time between volumes, 0 where it is not known or not even. Wavelengths and times
    of all volumes are JSON in a header extension (code 6, comment), and in short in ``descrip``.

    Raises
    ------
    InvalidInput
        As of :func:`write_nifti`.
    """
    header = _header(source.first, (*source.first.shape, len(source.volumes)))
    header.set_xyzt_units("mm", "sec")
    header["pixdim"][4] = (len(source.channels) == 1 and source.interval) or 0.0
    lights = ",".join(f"{1e9 * source.frames[group[0]].excitation:g}" for group in source.channels)
    lights = f"{lights} nm, " if source.frames[0].excitation else ""
    header["descrip"] = f"p0, {lights}{len(source.frames)} frames"[:79].encode()
    text = json.dumps(source.description()).encode()
    size = -(-(len(text) + 8) // 16) * 16
    extension = b"\1\0\0\0" + struct.pack("<ii", size, COMMENT) + text.ljust(size - 8, b"\0")
    with _opened(path) as file:
        _write_header(file, header, extension)
        for volume in source.volumes:
            for slab in volume.depth_slabs():
                file.write(slab.tobytes())


def _header(source: VolumeExportSource, shape: tuple[int, ...]) -> Any:
    """Return a header with shape, type and affine; raises InvalidInput for too many voxels or without nibabel."""
    nibabel = import_optional("nibabel", "nifti")
    if max(shape) > LONGEST:
        raise InvalidInput("volume", f"{shape} voxels", f"at most {LONGEST} an axis in NIfTI-1; take nrrd")
    header = nibabel.Nifti1Header()
    header.set_data_dtype(source.dtype)
    header.set_data_shape(shape)
    affine = np.diag([*(1e3 * step for step in source.spacing_xyz), 1.0])
    affine[:3, 3] = 1e3 * np.array(source.origin_xyz)
    header.set_qform(affine, code="scanner")
    header.set_sform(affine, code="scanner")
    return header


def _write_header(file: IO[bytes], header: Any, extension: bytes) -> None:
    """Write the header and its extensions, whose first four bytes say whether there are any."""
    header["vox_offset"], header["magic"] = len(header.binaryblock) + len(extension), b"n+1"
    file.write(header.binaryblock)
    file.write(extension)


def _opened(path: Path) -> IO[bytes]:
    return cast(IO[bytes], gzip.open(path, "wb", compresslevel=3) if path.suffix == ".gz" else path.open("wb"))
