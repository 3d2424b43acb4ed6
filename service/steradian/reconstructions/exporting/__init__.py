"""Exporting volumes: to HDF5, NIfTI, ImageJ TIFF, OME-Zarr, VTKHDF, NRRD and PNG.

Voxel sizes, origin and axis order are the volume's in every format; lengths are in the unit its readers expect:
metres in HDF5, millimetres in NIfTI, VTKHDF and NRRD, micrometres in TIFF and OME-Zarr.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal, TypeAlias, get_args

from steradian.core.atomic_files import atomic_write
from steradian.core.exceptions import Conflict, InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.reconstructions.exporting.source import VolumeExportSource, open_volume

__all__ = ["ENDINGS", "VolumeFormat", "export_volume", "format_of"]

VolumeFormat: TypeAlias = Literal["hdf5", "nifti", "tiff", "ome-zarr", "vtkhdf", "nrrd", "png"]
ENDINGS: dict[str, VolumeFormat] = {
    ".nii": "nifti",
    ".gz": "nifti",
    ".tif": "tiff",
    ".tiff": "tiff",
    ".zarr": "ome-zarr",
    ".vtkhdf": "vtkhdf",
    ".nrrd": "nrrd",
    ".png": "png",
    ".h5": "hdf5",
    ".hdf5": "hdf5",
}
"""Format of a volume by the ending of its name."""


def format_of(path: Path) -> VolumeFormat:
    """Return the format that a name's ending stands for.

    Raises
    ------
    InvalidInput
        When it stands for none.
    """
    found = ENDINGS.get(path.suffix.lower())
    if found is None:
        raise InvalidInput("file", f"{path.name} ({path.suffix or 'no ending'})", f"a name in {', '.join(ENDINGS)}")
    return found


def export_volume(
    volume: Path,
    destination: Path,
    *,
    format: VolumeFormat,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Path:
    """Write a volume file in another format.

    Parameters
    ----------
    volume
        A volume file, as a reconstruction leaves it.
    destination
        Where to; a file of that name is replaced once the new one is whole. OME-Zarr makes a folder, and so does PNG
        unless the name ends in ``.png``; a folder is never replaced. NIfTI is compressed if the name ends in ``.gz``.
    format
        One of ``hdf5``, ``nifti``, ``tiff`` (ImageJ hyperstack), ``ome-zarr``, ``vtkhdf``, ``nrrd``, ``png``.
    progress, cancelled
        Reported and asked once a slab of some megabytes.

    Returns
    -------
    Path
        ``destination``.

    Raises
    ------
    NotFound, DamagedFile
        When the volume cannot be read.
    InvalidInput
        When the format is unknown, cannot hold the volume, or needs a library that is not installed.
    Conflict
        When ``destination`` is a folder.
    Cancelled
        When ``cancelled`` said so; nothing is left behind.
    """
    if format not in get_args(VolumeFormat):
        raise InvalidInput("format", format, ", ".join(get_args(VolumeFormat)))
    if destination.is_dir():
        raise Conflict(f"{destination} is a folder that exists; choose another name or remove it")
    with open_volume(volume, progress, cancelled) as source:
        destination.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(destination, keep_ending=True) as beside:
            _write(source, beside, format)
    return destination


def _write(source: VolumeExportSource, path: Path, format: VolumeFormat) -> None:
    match format:
        case "hdf5":
            from steradian.reconstructions.exporting.hdf5 import write_hdf5

            write_hdf5(source, path)
        case "nifti":
            from steradian.reconstructions.exporting.nifti import write_nifti

            write_nifti(source, path, compressed=path.suffix == ".gz")
        case "tiff":
            from steradian.reconstructions.exporting.tiff import write_tiff

            write_tiff(source, path)
        case "ome-zarr":
            from steradian.reconstructions.exporting.ome_zarr import write_ome_zarr

            write_ome_zarr(source, path)
        case "vtkhdf":
            from steradian.reconstructions.exporting.vtkhdf import write_vtkhdf

            write_vtkhdf(source, path)
        case "nrrd":
            from steradian.reconstructions.exporting.nrrd import write_nrrd

            write_nrrd(source, path)
        case "png":
            from steradian.reconstructions.exporting.png import write_png

            write_png(source, path)
