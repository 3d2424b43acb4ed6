"""``steradian.open()``: open a mask, plan, scan, volume or series file, with its type detected from the content."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from steradian.core.exceptions import DamagedFile, InvalidInput, NotFound

if TYPE_CHECKING:
    from steradian.imaging import Volume
    from steradian.masks import Mask
    from steradian.plans import ScanPlan
    from steradian.reconstructions.scan import Scan
    from steradian.reconstructions.series.series import Series

    Opened: TypeAlias = Mask | ScanPlan | Scan | Volume | Series

HDF5 = b"\x89HDF\r\n\x1a\n"
KNOWN = "a mask or plan (.json), a scan, a volume or a series (.h5) of Steradian, or the folder of a reconstruction"


def open(path: str | Path) -> Opened:
    """Open a mask, plan, scan, volume or series file, with its type detected from the content.

    Parameters
    ----------
    path
        A file written by Steradian; or a folder that a reconstruction has left, for its volume or series.

    Returns
    -------
    Mask, ScanPlan, Scan, Volume or Series
        Shows what it is when it is printed.

    Raises
    ------
    NotFound
        When there is no such file.
    DamagedFile
        When it is none of these, or damaged.
    InvalidInput
        When a value in it is out of range, or it is a table of a mask's points, which lacks the aperture.
    """
    wanted = Path(path)
    for name in ("volume.h5", "series.h5"):
        if wanted.is_dir() and (wanted / name).is_file():
            wanted = wanted / name
    if not wanted.is_file():
        raise NotFound("file", str(path))
    with wanted.open("rb") as file:
        start = file.read(16)
    if start.startswith(HDF5):
        return _of_hdf5(wanted)
    if start.lstrip().startswith(b"{"):
        return _of_json(wanted)
    if start.startswith(b"\x93NUMPY") or wanted.suffix.lower() == ".csv":
        allowed = "a file with a format marker; steradian.masks.read_mask(path, aperture) reads tables of points"
        raise InvalidInput("file", wanted.name, allowed)
    raise DamagedFile(f"{wanted} is not {KNOWN}")


def _of_hdf5(path: Path) -> Scan | Volume | Series:
    import h5py

    try:
        with h5py.File(path, "r") as file:
            kind = file.attrs.get("format")
    except OSError as error:
        raise DamagedFile(f"{path} cannot be read as HDF5: {error}") from error
    if kind == "steradian-scan":
        from steradian.reconstructions.scan import Scan

        return Scan(path)
    if kind == "steradian-volume":
        from steradian.reconstructions.volumes.file import read_volume

        return read_volume(path)
    if kind == "steradian-series":
        from steradian.reconstructions.series.series import read_series

        return read_series(path)
    told = "has no format" if kind is None else f"has the format {kind!r}"
    raise DamagedFile(f"{path} is HDF5, but {told}; not {KNOWN} ('steradian import' reads recordings of others)")


def _of_json(path: Path) -> Mask | ScanPlan:
    from steradian.masks import Mask
    from steradian.plans import ScanPlan
    from steradian.plans.files import read_json

    try:
        said: Any = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise DamagedFile(f"{path} is not JSON: {error}") from error
    if "mask" in said:
        return read_json(ScanPlan, path)
    if "positions" in said:
        return read_json(Mask, path)
    raise DamagedFile(f"{path} is JSON, but neither a mask (positions) nor a plan (mask)")
