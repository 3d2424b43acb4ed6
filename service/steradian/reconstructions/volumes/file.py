"""Volume files: values of a reconstruction with axes, units and provenance in HDF5 (``docs/volume-file.md``).

::

    /          attributes: format, schema_version, software, parameters (JSON), provenance (JSON); centre_m (2,), the
               place of x = y = 0 in the frame of the file that the sensors' positions came from, where that is another
    values     (Nx, Ny, Nz) f4   attributes: axes "x, y, z", spacing_m (3,), origin_m (3,), near_field_m
    levels/1, levels/2, …        coarser copies, each of means over 2 × 2 × 2 of the one before; attributes as values
    x, y, z    (Nx,) (Ny,) (Nz,) f8   centres of the voxels in metres: dimension scales of values and projections
    mip_x, mip_y, mip_z          maximum-intensity projections along x, y and z

Values and levels are in chunks of about 64³ (:mod:`steradian.reconstructions.volumes.pyramid`), without compression.
From a line of sensors ``values`` is (Nx, Nz) in one piece, its axes "x, z", and there are neither levels nor
projections.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from steradian._version import __version__
from steradian.core.atomic_files import atomic_write
from steradian.core.exceptions import DamagedFile, InvalidInput, NotFound
from steradian.imaging import Volume, VoxelAxes
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.volumes.grid import VoxelGrid
from steradian.reconstructions.volumes.projections import Projections, project
from steradian.reconstructions.volumes.pyramid import chunk_shape, pyramid_shapes
from steradian.scans.file.h5py_errors import reraise_as_damaged

if TYPE_CHECKING:
    import h5py

FORMAT, VERSION = "steradian-volume", 1
SERIES_FORMAT, SERIES_VERSION = "steradian-series", 1


def write_volume(
    path: Path,
    volume: Volume,
    *,
    parameters: dict[str, Any],
    provenance: dict[str, Any],
    projections: Projections | None = None,
    near_field: float = 0.0,
    centre: tuple[float, ...] = (),
) -> None:
    """Write a volume file (atomic write) with its resolution pyramid; ``projections``, if given, are reused.

    ``near_field`` is the depth in metres from which on pictures show it, ``centre`` that of :class:`Recording`.

    It is not forced onto the disk: a volume that a power cut has spoiled can be made again from its scan.

    Raises
    ------
    OSError
        When the disk is full; ``path`` is then untouched.
    """
    import h5py

    with atomic_write(path) as beside, h5py.File(beside, "w") as file:
        file.attrs.update(
            {
                "format": FORMAT,
                "schema_version": VERSION,
                "software": f"steradian {__version__}",
                "parameters": json.dumps(_with_speed(parameters, volume)),
                "provenance": json.dumps(provenance),
                **({"centre_m": np.asarray(centre, np.float64)} if centre else {}),
            }
        )
        write_axes(file, {name: volume.coordinates(name) for name in volume.names})
        write_image(file, volume, projections=projections, near_field=near_field, scales=file)


def write_image(
    group: h5py.Group, volume: Volume, *, projections: Projections | None, near_field: float, scales: h5py.File
) -> None:
    """Write values, pyramid and projections of a volume into a group; ``scales`` has the axes."""
    lattice = VoxelGrid(volume.names, volume.origin, volume.spacing, volume.values.shape)
    _write_values(group, "values", volume.values, lattice).attrs["near_field_m"] = near_field
    _write_levels(group, volume.values, lattice)
    if volume.dimensions == 3:
        for axis, image in (projections or project(volume)).items():
            group.create_dataset(f"mip_{axis}", data=image)
    attach_dimension_scales(group, scales)


def _write_values(file: h5py.Group, name: str, values: NDArray[Any], lattice: VoxelGrid) -> h5py.Dataset:
    chunks = chunk_shape(values.shape)
    dataset = file.create_dataset(name, data=values, chunks=chunks)
    dataset.attrs.update(
        {
            "axes": ", ".join(lattice.names),
            "spacing_m": np.asarray(lattice.spacing, dtype=np.float64),
            "origin_m": np.asarray(lattice.origin, dtype=np.float64),
        }
    )
    return dataset


def _write_levels(file: h5py.Group, values: NDArray[Any], lattice: VoxelGrid) -> None:
    """Write the resolution pyramid: each level is the previous one downsampled by 2."""
    for level, _ in enumerate(pyramid_shapes(values.shape), 1):
        from steradian.reconstructions.volumes.downsample import (
            downsample,  # compiled: what is small does not wait for it
        )

        values = downsample(values)
        _write_values(file, f"levels/{level}", values, lattice.downsampled(2**level))


def write_projections(path: Path, volume: Volume, projections: Projections) -> None:
    """Write a file with the axes and projections of a volume but without values; replaces an existing file.

    Origin, spacing, names of the axes and shape are attributes of the file itself.
    """
    import h5py

    with atomic_write(path) as beside, h5py.File(beside, "w") as file:
        file.attrs.update(
            {
                "format": "steradian-projections",
                "schema_version": 1,
                "software": f"steradian {__version__}",
                "axes": ", ".join(volume.names),
                "shape": np.asarray(volume.values.shape),
                "spacing_m": np.asarray(volume.spacing, dtype=np.float64),
                "origin_m": np.asarray(volume.origin, dtype=np.float64),
            }
        )
        for axis, image in projections.items():
            file.create_dataset(f"mip_{axis}", data=image)


def write_axes(file: h5py.File, coordinates: Mapping[str, NDArray[np.float64]]) -> None:
    """Write the coordinates of the voxel centres in metres as HDF5 dimension scales."""
    for name, line in coordinates.items():
        file.create_dataset(name, data=line).attrs["units"] = "m"
        file[name].make_scale(name)


def attach_dimension_scales(file: h5py.Group, scales: h5py.File) -> None:
    """Attach the HDF5 dimension scales of the axes to the values and to every projection of a group."""
    names = [name for name in "xyz" if name in scales]
    for dataset in ("values", *(f"mip_{name}" for name in names)):
        if dataset not in file:
            continue
        left = [name for name in names if name != dataset.removeprefix("mip_")]
        for dimension, name in zip(file[dataset].dims, left, strict=True):
            dimension.label = name
            dimension.attach_scale(scales[name])


def _with_speed(parameters: dict[str, Any], volume: Volume) -> dict[str, Any]:
    known = volume.sound_speed is None or parameters.get("medium")
    return parameters if known else parameters | {"sound_speed": volume.sound_speed}


def read_projection(path: Path, axis: Literal["x", "y", "z"]) -> NDArray[np.floating[Any]]:
    """Read the stored projection along an axis from a volume file; for a 2-D image, the image itself.

    Raises
    ------
    NotFound
        When there is no such file.
    DamagedFile
        When it is truncated or of another kind.
    """
    import h5py

    if not path.is_file():
        raise NotFound("file", str(path))
    with reraise_as_damaged(path, "volume"), h5py.File(path, "r") as file:
        image = np.asarray(file[f"mip_{axis}" if f"mip_{axis}" in file else "values"])
    if image.ndim != 2:
        raise DamagedFile(f"{path}: the projection along {axis} has {image.ndim} axes, not 2")
    return image


def check_format(file: h5py.File, path: Path, *, or_series: bool = False) -> None:
    """Raise :class:`DamagedFile` if an HDF5 file is not a volume file (or a series file) or has an unknown version."""
    versions = {FORMAT: VERSION} | ({SERIES_FORMAT: SERIES_VERSION} if or_series else {})
    if (kind := file.attrs.get("format")) not in versions:
        raise DamagedFile(f"{path} is an HDF5 file, but its format is {kind!r}; expected {FORMAT!r}")
    if (version := file.attrs.get("schema_version")) != versions[kind]:
        raise DamagedFile(f"{path}: schema_version is {version}; allowed: {versions[kind]}")


def volume_group(file: h5py.File, index: int | None) -> h5py.Group:
    """Return the group of a volume in an open file: the file itself, or the one with an index in a series file.

    Raises
    ------
    InvalidInput
        When there is none with this index, or a series' index is not stated.
    """
    frames = file.get("frames")
    if frames is None:
        if index:
            raise InvalidInput("index", index, "0: this is a single volume")
        return file
    if index is None or index >= len(frames):
        value = "missing" if index is None else index
        raise InvalidInput("index", value, f"0 to {len(frames) - 1}: which volume of the series")
    return frames[str(index)]


def centre_in(file: h5py.File, axes: int) -> tuple[float, ...]:
    """Return the offset in metres, per axis, from the file's coordinates to those of the imported source."""
    centre = tuple(map(float, np.ravel(file.attrs.get("centre_m", ()))))
    return (*centre, 0.0) if len(centre) == axes - 1 else (0.0,) * axes


def read_volume(path: Path, index: int | None = None) -> Volume:
    """Read a volume file, or the volume of a series file with an index, into memory.

    Raises
    ------
    NotFound
        When there is no such file.
    DamagedFile
        When it is truncated or of another kind.
    InvalidInput
        As of :func:`volume_group`.
    """
    import h5py

    if not path.is_file():
        raise NotFound("file", str(path))
    with reraise_as_damaged(path, "volume"), h5py.File(path, "r") as file:
        check_format(file, path, or_series=True)
        return volume_of(volume_group(file, index), json.loads(file.attrs["parameters"]))


def volume_of(group: h5py.Group, parameters: dict[str, Any]) -> Volume:
    """Return the volume in a group of an open file, reconstructed with these parameters."""
    values = group["values"]
    spacing, origin = (tuple(map(float, values.attrs[name])) for name in ("spacing_m", "origin_m"))
    lines = zip(origin, spacing, values.shape, strict=True)
    x, *y, z = (first + step * np.arange(count) for first, step, count in lines)
    speeds = [layer["sound_speed"] for layer in parameters.get("medium") or ()]
    speed = min(speeds) if speeds else parameters.get("sound_speed")
    return Volume(np.asarray(values), VoxelAxes(x, y[0] if y else None, z), spacing, speed)


def read_parameters(path: Path) -> ReconstructionParameters:
    """Read the reconstruction parameters from a volume or series file; raises as :func:`read_volume`."""
    import h5py

    if not path.is_file():
        raise NotFound("file", str(path))
    with reraise_as_damaged(path, "volume"), h5py.File(path, "r") as file:
        check_format(file, path, or_series=True)
        said = json.loads(file.attrs["parameters"])
    return ReconstructionParameters.create(**said)
