"""Export of volumes to HDF5, NIfTI, ImageJ TIFF, OME-Zarr, VTKHDF, NRRD and PNG.

Voxel sizes, origin and axis order are the volume's in every format; lengths are in the unit its readers expect:
metres in HDF5, millimetres in NIfTI, VTKHDF and NRRD, micrometres in TIFF and OME-Zarr.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, NamedTuple, TypeAlias

from steradian.core.atomic_files import atomic_write
from steradian.core.exceptions import Conflict, InvalidInput
from steradian.core.progress import CancelCheck, Progress

__all__ = ["ENDINGS", "FORMATS", "VolumeFormat", "export_volume", "format_of"]


class FormatEntry(NamedTuple):
    """Registry entry of an export format: endings and writer function.

    Attributes
    ----------
    suffix
        Ending of the name of an exported file.
    endings
        Endings of names that stand for the format, without a dot of compression before them.
    writer
        Module of this package and its function ``(source, path)``, imported when the format is first written.
    """

    suffix: str
    endings: tuple[str, ...]
    writer: str


FORMATS: Final = {
    "hdf5": FormatEntry(".h5", (".h5", ".hdf5"), "hdf5.write_hdf5"),
    "nifti": FormatEntry(".nii.gz", (".nii", ".gz"), "nifti.write_nifti"),
    "tiff": FormatEntry(".tif", (".tif", ".tiff"), "tiff.write_tiff"),
    "ome-zarr": FormatEntry(".ome.zarr", (".zarr",), "ome_zarr.write_ome_zarr"),
    "vtkhdf": FormatEntry(".vtkhdf", (".vtkhdf",), "vtkhdf.write_vtkhdf"),
    "nrrd": FormatEntry(".nrrd", (".nrrd",), "nrrd.write_nrrd"),
    "png": FormatEntry(".projections", (".png",), "png.write_png"),
}
"""Registry of the export formats of volumes, by name."""

if TYPE_CHECKING:
    VolumeFormat: TypeAlias = str
else:
    VolumeFormat = Literal[tuple(FORMATS)]
ENDINGS: Final[dict[str, str]] = {ending: name for name, entry in FORMATS.items() for ending in entry.endings}
"""Format of a volume by the ending of its name."""


def format_of(path: Path) -> VolumeFormat:
    """Return the export format for the ending of a file name.

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
    index: int | None = None,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Path:
    """Convert a volume file, or a volume of a series file, to another format.

    Parameters
    ----------
    volume
        A volume file, as a reconstruction leaves it.
    destination
        Where to; a file of that name is replaced once the new one is whole. OME-Zarr makes a folder, and so does PNG
        unless the name ends in ``.png``; a folder is never replaced. NIfTI is compressed if the name ends in ``.gz``.
    format
        A name in :data:`FORMATS`; ``tiff`` is an ImageJ hyperstack.
    index
        Which volume of a series file, from 0.
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
    if format not in FORMATS:
        raise InvalidInput("format", format, ", ".join(FORMATS))
    if destination.is_dir():
        raise Conflict(f"{destination} is a folder that exists; choose another name or remove it")
    from steradian.reconstructions.exporting.source import open_volume

    module, function = FORMATS[format].writer.split(".")
    write = getattr(import_module(f"{__name__}.{module}"), function)
    with open_volume(volume, progress, cancelled, index) as source:
        destination.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(destination, keep_ending=True) as beside:
            write(source, beside)
    return destination
