"""Format detection of recordings by content, and opening as a recording source."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import DamagedFile, InvalidInput, NotFound
from steradian.core.progress import Progress
from steradian.scans.file import schema
from steradian.scans.importing import ipasc, kwave, mat5, matlab, numpy_files, sgl, untrusted
from steradian.scans.importing.description import Description, read_description
from steradian.scans.importing.import_remarks import collecting_remarks
from steradian.scans.importing.source import RecordingSource
from steradian.scans.importing.text import is_text_table, open_csv, text_rows

HDF5, ZIP, NPY, MATLAB = b"\x89HDF\r\n\x1a\n", b"PK\x03\x04", b"\x93NUMPY", b"MATLAB 7.3"


@contextmanager
def open_recording_source(
    path: Path,
    description: Path | None = None,
    folder: Path | None = None,
    note: Progress | None = None,
    options: Mapping[str, Any] | None = None,
) -> Iterator[RecordingSource]:
    """Open a recording of any importable format as a source that is read in blocks.

    Parameters
    ----------
    path
        IPASC HDF5, k-Wave output HDF5, MATLAB, .npy, .npz, .sgl or .csv.
    description
        A JSON file that says what the file does not (:class:`~steradian.scans.importing.description.Description`).
    folder
        Where a scratch file may lie; the system's place for such files if not given.
    note
        Told how far the opening is where that takes long; may raise ``Cancelled``.
    options
        Fields that replace those of the description, in SI units.

    Raises
    ------
    NotFound
        When a file is missing.
    DamagedFile
        When it is of no known kind, damaged, or holds what is refused.
    InvalidInput
        When something needed is stated nowhere or out of range.
    """
    said, companion = _with_positions(read_description(description, options), description)
    with collecting_remarks(), _opened(path, said, companion, folder, note) as source:
        yield source


def is_scan_file(path: Path) -> bool:
    """Return whether a file is a scan file of this program, by its HDF5 format attribute.

    Raises
    ------
    DamagedFile
        When it begins as HDF5 but cannot be opened.
    """
    if not _magic_bytes(path).startswith(HDF5):
        return False
    with untrusted.open_root_only(path) as file:
        return _format(file) == schema.FORMAT


def _opened(
    path: Path, said: Description, companion: Path | None, folder: Path | None, note: Progress | None
) -> AbstractContextManager[RecordingSource]:
    magic = _magic_bytes(path)
    if magic.startswith((HDF5, MATLAB)):
        return _opened_hdf5(path, said, companion, folder, note)
    if magic.startswith(mat5.MAGIC):
        return matlab.open_matlab_5(path, said, folder)
    if magic.startswith(ZIP):
        return numpy_files.open_npz(path, said, folder)
    if magic.startswith(NPY):
        return numpy_files.open_npy(path, said)
    if sgl.is_sgl(path, said.file_name):
        return sgl.open_sgl(path, said)
    if is_text_table(path):
        return open_csv(path, said, folder)
    raise DamagedFile(
        f"{path.name} is neither HDF5 (IPASC, k-Wave), MATLAB (save, from version 5), .npy, .npz, .sgl nor .csv"
    )


def _opened_hdf5(
    path: Path, said: Description, companion: Path | None, folder: Path | None, note: Progress | None
) -> AbstractContextManager[RecordingSource]:
    with untrusted.open_root_only(path) as file:
        names = set(untrusted.top_names(file))
        kind = _format(file)
    if ipasc.SERIES in names:
        return ipasc.open_ipasc(path, said, note)
    if names.intersection(name.split("/")[0] for name in matlab.wanted_names(said)):
        return matlab.open_matlab(path, said, folder)
    if names.issuperset(kwave.GRID):
        return kwave.open_kwave(path, said, companion, folder)
    raise DamagedFile(
        f"{path.name} is an HDF5 file, but its format is {kind!r}; expected {schema.FORMAT!r}, IPASC "
        f"({ipasc.SERIES}), k-Wave output (p, Nx, …) or MATLAB 7.3 (sensor_data)"
    )


def _format(file: h5py.File) -> str | None:
    """Return the format attribute of an HDF5 file, if it is a single text."""
    if "format" not in file.attrs or file.attrs.get_id("format").shape != ():
        return None
    return str(file.attrs["format"])


def _magic_bytes(path: Path) -> bytes:
    if not path.is_file():
        raise NotFound("file", path.name)
    with path.open("rb") as file:
        return file.read(16)


def _with_positions(said: Description, description: Path | None) -> tuple[Description, Path | None]:
    """Replace the name of a positions file in a description by its content; return a k-Wave input file as path."""
    if not isinstance(said.positions, str) or description is None:
        return said, None
    path = description.parent / said.positions
    kind = _magic_bytes(path)
    if path.stat().st_size > untrusted.SMALL_BYTES:
        raise DamagedFile(f"{path.name} has {path.stat().st_size} bytes; allowed: {untrusted.SMALL_BYTES}")
    if kind.startswith(HDF5):
        return said, path
    if kind.startswith(NPY):
        return said.replace(positions=_npy_positions(path)), None
    with path.open("rb") as file:
        rows = list(text_rows(file, path))
    if not rows or len({len(row) for row in rows}) != 1:
        raise DamagedFile(f"{path.name} has no rows of the same length")
    return said.replace(positions=np.array(rows)), None


def _npy_positions(path: Path) -> NDArray[np.float64]:
    found = numpy_files.read_npy(path)
    if found.ndim != 2:
        raise InvalidInput("positions", f"an array of shape {found.shape}", "(M, 1 to 3) numbers")
    return found.astype(np.float64)
