"""Volume files: a reconstruction's values with axes, units and provenance, in HDF5.

::

    /          attributes: format, schema_version, software, parameters (JSON), provenance (JSON)
    values     (Nx, Ny, Nz) f4   attributes: axes "x, y, z", spacing_m (3,), origin_m (3,), near_field_m
    mip_x, mip_y, mip_z          maximum-intensity projections along x, y and z

From a line of sensors ``values`` is (Nx, Nz), its axes "x, z", and there are no projections.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np
from numpy.typing import NDArray

from steradian import __version__
from steradian.errors import DamagedFile, NotFound
from steradian.imaging import Axes, Volume
from steradian.reconstructions.projections import Projections, project

FORMAT, VERSION = "steradian-volume", 1


def write_volume(
    path: Path,
    volume: Volume,
    *,
    parameters: dict[str, Any],
    provenance: dict[str, Any],
    projections: Projections | None = None,
    near_field: float = 0.0,
) -> None:
    """Write a volume under a temporary name and rename it when it is whole; ``projections`` where they are there.

    ``near_field`` is the depth in metres from which on pictures show it.

    It is not forced onto the disk: a volume that a power cut has spoiled can be made again from its scan.

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
                    "near_field_m": near_field,
                }
            )
            if volume.dimensions == 3:
                for axis, image in (projections or project(volume)).items():
                    file.create_dataset(f"mip_{axis}", data=image)
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


def read_projection(path: Path, axis: Literal["x", "y", "z"]) -> NDArray[np.floating[Any]]:
    """Read the projection along one axis from a volume file; of an image from a line of sensors, the image itself.

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
            return np.asarray(file[f"mip_{axis}" if f"mip_{axis}" in file else "values"])
    except (OSError, KeyError) as error:
        raise DamagedFile(f"{path} cannot be read as a volume: {error}") from error


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
