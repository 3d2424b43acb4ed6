"""Export of volumes as NIfTI-1, a format of neuroimaging tools and most viewers."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import IO, cast

import numpy as np

from steradian._version import __version__
from steradian.core.exceptions import InvalidInput
from steradian.reconstructions.exporting.optional_imports import import_optional
from steradian.reconstructions.exporting.source import VolumeExportSource

LONGEST = 32_767
DATA_OFFSET = 352


def write_nifti(source: VolumeExportSource, path: Path) -> None:
    """Write a volume as NIfTI-1 in millimetres, with the affine from voxel to (right, anterior, superior) = (x, y, z).

    The file is compressed if its name ends in ``.gz``.

    Raises
    ------
    InvalidInput
        When an axis is longer than the format can count, or nibabel is not installed.
    """
    nibabel = import_optional("nibabel", "nifti")
    if max(source.shape) > LONGEST:
        raise InvalidInput("volume", f"{source.shape} voxels", f"at most {LONGEST} an axis in NIfTI-1; take nrrd")
    header = nibabel.Nifti1Header()
    header.set_data_dtype(source.dtype)
    header.set_data_shape(source.shape)
    header.set_xyzt_units("mm")
    affine = np.diag([*(1e3 * step for step in source.spacing_xyz), 1.0])
    affine[:3, 3] = 1e3 * np.array(source.origin_xyz)
    header.set_qform(affine, code="scanner")
    header.set_sform(affine, code="scanner")
    header["descrip"] = f"initial pressure, steradian {__version__}".encode()
    header["vox_offset"], header["magic"] = DATA_OFFSET, b"n+1"
    opened = gzip.open(path, "wb", compresslevel=3) if path.suffix == ".gz" else path.open("wb")
    with opened as file:
        file.write(header.binaryblock)
        file.write(bytes(DATA_OFFSET - len(header.binaryblock)))
        for slab in source.depth_slabs():
            cast(IO[bytes], file).write(slab.tobytes())
