"""Export of series to NIfTI (4-D), ImageJ TIFF (time, depth, channel), OME-Zarr (time, channel) and plain HDF5.

Wavelengths are the channels and repetitions the times, if each wavelength has as many; else each volume is a channel.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from steradian.core.atomic_files import atomic_write
from steradian.core.exceptions import Conflict, InvalidInput
from steradian.core.progress import CancelCheck, Progress

if TYPE_CHECKING:
    from steradian.reconstructions.exporting.series_source import SeriesExportSource

SERIES_FORMATS: Final = ("hdf5", "nifti", "tiff", "ome-zarr")
"""Names of the export formats of series."""


def export_series(
    series: Path,
    destination: Path,
    *,
    format: str,
    sidecar: bool = False,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Path:
    """Convert a series file to another format; one slab of one volume is in memory at a time.

    Parameters
    ----------
    series
        A series file, as a reconstruction leaves it.
    destination
        Where to; a file of that name is replaced once the new one is whole. OME-Zarr makes a folder, which is never
        replaced. NIfTI is compressed if the name ends in ``.gz``.
    format
        A name in :data:`SERIES_FORMATS`.
    sidecar
        Whether a NIfTI file gets a JSON file beside it with wavelengths and times (as BIDS has them). They are in an
        extension of its header in any case.
    progress, cancelled
        Reported and asked once a slab of some megabytes.

    Returns
    -------
    Path
        ``destination``.

    Raises
    ------
    NotFound, DamagedFile
        When the series cannot be read.
    InvalidInput
        When the format is unknown or of single volumes, cannot hold the series, or needs a library that is missing.
    Conflict
        When ``destination`` is a folder.
    Cancelled
        When ``cancelled`` said so; nothing is left behind.
    """
    if format not in SERIES_FORMATS:
        allowed = f"{', '.join(SERIES_FORMATS)} for a series; steradian.open(…)[0].save(…) writes one volume"
        raise InvalidInput("format", format, allowed)
    if destination.is_dir():
        raise Conflict(f"{destination} is a folder that exists; choose another name or remove it")
    from steradian.reconstructions.exporting.series_source import open_series

    with open_series(series, progress, cancelled) as source:
        destination.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(destination, keep_ending=True) as beside:
            _writer(format)(source, beside)
        if sidecar and format == "nifti":
            with atomic_write(sidecar_path(destination)) as beside:
                beside.write_text(json.dumps(source.description(), indent=1) + "\n", encoding="utf-8")
    return destination


def _writer(format: str) -> Callable[[SeriesExportSource, Path], None]:
    """Return the writer of a format, imported when it is first needed."""
    if format == "hdf5":
        from steradian.reconstructions.exporting.hdf5 import write_hdf5_series

        return write_hdf5_series
    if format == "nifti":
        from steradian.reconstructions.exporting.nifti import write_nifti_series

        return write_nifti_series
    if format == "tiff":
        from steradian.reconstructions.exporting.tiff import write_tiff_series

        return write_tiff_series
    from steradian.reconstructions.exporting.ome_zarr import write_ome_zarr_series

    return write_ome_zarr_series


def sidecar_path(path: Path) -> Path:
    """Return the name of the JSON file beside a NIfTI file: without ``.gz``, ``.json`` instead of ``.nii``."""
    return path.with_name(path.name.removesuffix(".gz").removesuffix(".nii") + ".json")
