"""Volume files: a reconstruction's values with axes, units and provenance, in HDF5.

::

    /          attributes: format, schema_version, software, parameters (JSON), provenance (JSON)
    values     (Nx, Ny, Nz) f4   attributes: axes "x, y, z", spacing_m (3,), origin_m (3,)
    mip_x, mip_y, mip_z          maximum-intensity projections along x, y and z

From a line of sensors ``values`` is (Nx, Nz), its axes "x, z", and there are no projections.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np

from steradian import __version__
from steradian.errors import DamagedFile, NotFound
from steradian.imaging import Axes, Volume

FORMAT, VERSION = "steradian-volume", 1
AXES: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")


def write_volume(path: Path, volume: Volume, *, parameters: dict[str, Any], provenance: dict[str, Any]) -> None:
    """Write a volume under a temporary name and rename it when it is whole.

    Raises
    ------
    OSError
        When the disk is full; ``path`` is then untouched.
    """
    draft = path.with_name(path.name + ".new")
    try:
        with h5py.File(draft, "w") as file:
            file.attrs.update(
                {
                    "format": FORMAT,
                    "schema_version": VERSION,
                    "software": f"steradian {__version__}",
                    "parameters": json.dumps(parameters),
                    "provenance": json.dumps(provenance),
                }
            )
            values = file.create_dataset("values", data=volume.values)
            values.attrs.update(
                {
                    "axes": ", ".join(volume.names),
                    "spacing_m": np.asarray(volume.spacing, dtype=np.float64),
                    "origin_m": np.asarray(volume.origin, dtype=np.float64),
                }
            )
            if volume.dimensions == 3:
                for axis in AXES:
                    file.create_dataset(f"mip_{axis}", data=volume.mip(axis))
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


def read_volume(path: Path) -> Volume:
    """Read a volume file.

    Raises
    ------
    NotFound
        When there is no such file.
    DamagedFile
        When it is truncated or of another kind.
    """
    if not path.is_file():
        raise NotFound("file", str(path))
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("format") != FORMAT or file.attrs.get("schema_version") != VERSION:
                raise DamagedFile(f"{path} is no volume file of schema version {VERSION}")
            values = file["values"]
            spacing, origin = (tuple(map(float, values.attrs[name])) for name in ("spacing_m", "origin_m"))
            lines = zip(origin, spacing, values.shape, strict=True)
            x, *y, z = (first + step * np.arange(count) for first, step, count in lines)
            return Volume(np.asarray(values), Axes(x, y[0] if y else None, z), spacing)
    except (OSError, KeyError) as error:
        raise DamagedFile(f"{path} cannot be read as a volume: {error}") from error
