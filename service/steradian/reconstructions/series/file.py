"""Series files: the volumes of a series in one HDF5 file, each in a group like a volume file.

::

    /               attributes: format "steradian-series", schema_version, software, parameters, provenance (JSON)
    x, y, z         centres of the voxels in metres: dimension scales
    frames/0, 1, …  groups with values, levels and projections as in a volume file; attributes: numbers (n,) of the
                    scan's frames, excitation_m (0: not stated), time_s since the first shot (NaN: not known), and
                    name of a map that was computed of a series
    centre_m        attribute, as in a volume file
"""

from __future__ import annotations

import json
import math
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from steradian._version import __version__
from steradian.core.atomic_files import atomic_write
from steradian.core.exceptions import DamagedFile, InvalidInput, NotFound
from steradian.imaging import Volume, VoxelAxes
from steradian.reconstructions.series.frames import SeriesFrame
from steradian.reconstructions.volumes.file import SERIES_FORMAT, SERIES_VERSION, write_axes, write_image
from steradian.reconstructions.volumes.projections import Projections
from steradian.scans.file.h5py_errors import reraise_as_damaged

if TYPE_CHECKING:
    import h5py


class SeriesWriter:
    """Writer of a series file, volume by volume; the file appears under its name when the context ends (atomic write).

    Parameters
    ----------
    path
        File to write.
    parameters, provenance
        Effective parameters of the reconstruction, and the identifiers of scan, plan, mask and scanner.
    centre
        As of :func:`steradian.reconstructions.volumes.file.write_volume`.
    """

    def __init__(
        self, path: Path, *, parameters: dict[str, Any], provenance: dict[str, Any], centre: tuple[float, ...] = ()
    ) -> None:
        self._path, self._parameters, self._provenance, self._centre = path, parameters, provenance, centre
        self._context, self._count = ExitStack(), 0
        self._file: h5py.File = None  # open within the context
        self._axes: VoxelAxes | None = None

    def __enter__(self) -> Self:
        import h5py

        beside = self._context.enter_context(atomic_write(self._path))
        self._file = self._context.enter_context(h5py.File(beside, "w"))
        self._file.attrs.update(
            {
                "format": SERIES_FORMAT,
                "schema_version": SERIES_VERSION,
                "software": f"steradian {__version__}",
                "parameters": json.dumps(self._parameters),
                "provenance": json.dumps(self._provenance),
                **({"centre_m": np.asarray(self._centre, np.float64)} if self._centre else {}),
            }
        )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._context.__exit__(kind, error, traceback)

    def add(
        self, frame: SeriesFrame, volume: Volume, *, projections: Projections | None = None, near_field: float = 0.0
    ) -> None:
        """Append a volume, on the voxels of the first one.

        Raises
        ------
        InvalidInput
            If its voxels are others.
        """
        if self._axes is None:
            write_axes(self._file, {name: volume.coordinates(name) for name in volume.names})
            self._axes = volume.axes
        elif not _same_axes(self._axes, volume.axes):
            raise InvalidInput("volume", f"voxels {volume.values.shape}", "those of the series' first volume")
        group = self._file.create_group(f"frames/{self._count}")
        time = math.nan if frame.time is None else frame.time
        numbers = np.array(frame.numbers, np.int64)
        group.attrs.update({"numbers": numbers, "excitation_m": frame.excitation, "time_s": time})
        if frame.name:
            group.attrs["name"] = frame.name
        write_image(group, volume, projections=projections, near_field=near_field, scales=self._file)
        self._count += 1


def is_series_file(path: Path) -> bool:
    """Return whether a file is a series file, by its HDF5 format attribute; of a file that is not HDF5 false."""
    import h5py

    if not path.is_file() or not h5py.is_hdf5(path):
        return False
    with reraise_as_damaged(path, "series"), h5py.File(path, "r") as file:
        return bool(file.attrs.get("format") == SERIES_FORMAT)


def read_frames(path: Path) -> list[SeriesFrame]:
    """Return the frames of a series file; raises as :func:`.series.read_series`."""
    import h5py

    if not path.is_file():
        raise NotFound("file", str(path))
    with reraise_as_damaged(path, "series"), h5py.File(path, "r") as file:
        _check_format(file, path)
        return [_frame_of(file[f"frames/{number}"].attrs) for number in range(len(file["frames"]))]


@dataclass(frozen=True)
class SeriesMetadata:
    """Parameters and provenance of a series, its near field's depth in m, and the centre of a volume file."""

    parameters: dict[str, Any]
    provenance: dict[str, str]
    near_field: float
    centre: tuple[float, ...]


def read_metadata(path: Path) -> SeriesMetadata:
    """Return the metadata of a series file; raises as :func:`.series.read_series`."""
    import h5py

    if not path.is_file():
        raise NotFound("file", str(path))
    with reraise_as_damaged(path, "series"), h5py.File(path, "r") as file:
        _check_format(file, path)
        parameters, provenance = (json.loads(file.attrs[name]) for name in ("parameters", "provenance"))
        centre = tuple(map(float, np.ravel(file.attrs.get("centre_m", ()))))
        return SeriesMetadata(parameters, provenance, float(file["frames/0/values"].attrs["near_field_m"]), centre)


def _frame_of(about: Any) -> SeriesFrame:
    time = float(about["time_s"])
    numbers = tuple(map(int, about["numbers"]))
    excitation, name = float(about["excitation_m"]), str(about.get("name", ""))
    return SeriesFrame(numbers, excitation, None if math.isnan(time) else time, name)


def _check_format(file: h5py.File, path: Path) -> None:
    if (kind := file.attrs.get("format")) != SERIES_FORMAT:
        raise DamagedFile(f"{path} is an HDF5 file, but its format is {kind!r}; expected {SERIES_FORMAT!r}")
    if (version := file.attrs.get("schema_version")) != SERIES_VERSION:
        raise DamagedFile(f"{path}: schema_version is {version}; allowed: {SERIES_VERSION}")


def _same_axes(one: VoxelAxes, other: VoxelAxes) -> bool:
    pairs = zip((one.x, one.y, one.z), (other.x, other.y, other.z), strict=True)
    return all(a is b is None or (a is not None and b is not None and np.array_equal(a, b)) for a, b in pairs)
