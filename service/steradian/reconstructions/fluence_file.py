"""Fluence maps from files: HDF5 of Steradian or of other programs, and NIfTI."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import DamagedFile, InvalidInput, NotFound
from steradian.imaging import VoxelAxes
from steradian.reconstructions.series.series import read_series
from steradian.reconstructions.volumes.file import FORMAT as VOLUME
from steradian.reconstructions.volumes.file import SERIES_FORMAT as SERIES
from steradian.reconstructions.volumes.file import read_volume
from steradian.scans.file.h5py_errors import reraise_as_damaged
from steradian.spectroscopy import FluenceMap

if TYPE_CHECKING:
    import h5py

__all__ = ["read_fluence_map"]

NAMED = re.compile(r"(\d+(?:\.\d+)?)\s*nm", re.IGNORECASE)
LARGEST = 4 << 30
"""Most bytes of a map in memory."""
SUFFIXES = (".nii", ".gz", ".h5", ".hdf5")


def read_fluence_map(path: str | Path, *, wavelengths: Iterable[float] = ()) -> FluenceMap:
    """Read a fluence map, relative to the same surface at all wavelengths.

    - A series file of Steradian: its volumes are the fluence at their excitation wavelengths. A volume file: the
      fluence at all wavelengths.
    - Other HDF5: a dataset ``values`` or ``fluence``, shape (wavelengths, x, y, z), with ``excitation_m`` (in m) or
      ``wavelength_nm``; or one dataset [x, y, z] for each wavelength, called ``750nm``. Coordinates of the voxels in
      m are datasets ``x``, ``y`` and ``z``; without them the map has the voxels of the series.
    - NIfTI: [x, y, z], or [x, y, z, wavelength]. Coordinates are those of the affine, wavelengths those that
      :func:`.export_series` writes, or ``wavelengths``.

    Parameters
    ----------
    path
        The file.
    wavelengths
        Wavelengths in m of the maps of a 4-D array that states none.

    Raises
    ------
    NotFound
        When there is no such file.
    DamagedFile
        When it is not readable, or has no fluence.
    InvalidInput
        When it is of another kind, or wavelengths are missing.
    """
    wanted = Path(path)
    if not wanted.is_file():
        raise NotFound("file", str(path))
    if wanted.suffix.lower() not in SUFFIXES:
        raise InvalidInput("fluence", wanted.name, f"a map in {', '.join(SUFFIXES)}")
    given = tuple(map(float, wavelengths))
    if wanted.suffix.lower() in (".nii", ".gz"):
        return _of_nifti(wanted, given)
    import h5py

    with reraise_as_damaged(wanted, "fluence map"), h5py.File(wanted, "r") as file:
        kind = file.attrs.get("format")
        if kind not in (SERIES, VOLUME):
            return _of_hdf5(file, wanted, given)
    if kind == VOLUME:
        volume = read_volume(wanted)
        return FluenceMap(_as_4d(volume.values[None]), (), volume.axes)
    series = read_series(wanted)
    if not series.wavelengths:
        raise InvalidInput("fluence", wanted.name, "a series with excitation wavelengths, or a volume")
    means = np.stack([series.at(light).mean().values for light in series.wavelengths])
    return FluenceMap(_as_4d(means), series.wavelengths, series[0].axes)


def _of_hdf5(file: h5py.File, path: Path, given: tuple[float, ...]) -> FluenceMap:
    names = [name for name in file if NAMED.fullmatch(name.strip())]
    array = next((name for name in ("values", "fluence") if name in file), None)
    if array is not None:
        _check_size(path, file[array])
        values = np.asarray(file[array])
        lights = given
        if "excitation_m" in file:
            lights = tuple(map(float, np.ravel(file["excitation_m"])))
        elif "wavelength_nm" in file:
            lights = tuple(1e-9 * float(each) for each in np.ravel(file["wavelength_nm"]))
        values = values if values.ndim == 4 else values[None]
    elif names:
        for name in names:
            _check_size(path, file[name], len(names))
        values = np.stack([np.asarray(file[name]) for name in names])
        lights = tuple(1e-9 * float(NAMED.fullmatch(name.strip())[1]) for name in names)  # type: ignore[index]
    else:
        raise DamagedFile(f"{path} has no dataset values, fluence or 750nm (a wavelength) with a fluence")
    axes = None
    if all(name in file for name in "xyz"):
        x, y, z = (np.asarray(file[name], np.float64).ravel() for name in "xyz")
        axes = VoxelAxes(x, y, z)
    return _checked(path, _as_4d(values), lights, axes)


def _of_nifti(path: Path, given: tuple[float, ...]) -> FluenceMap:
    from steradian.reconstructions.exporting.optional_imports import import_optional

    nibabel = import_optional("nibabel", "nifti")
    try:
        image = nibabel.load(path)
        _check_size(path, image)
        values = np.asarray(image.dataobj)
    except (OSError, ValueError, nibabel.filebasedimages.ImageFileError) as error:
        raise DamagedFile(f"{path} cannot be read as NIfTI: {error}") from error
    if values.ndim not in (3, 4):
        raise InvalidInput("fluence", f"{values.ndim} axes", "x, y, z, or x, y, z, wavelength")
    unit = {"mm": 1e-3, "meter": 1.0, "micron": 1e-6}.get(image.header.get_xyzt_units()[0], 1e-3)
    affine = np.asarray(image.affine, np.float64)
    steps = np.diag(affine)[:3]
    if np.abs(affine[:3, :3] - np.diag(steps)).max() > 1e-6 * np.abs(steps).max() or not steps.all():
        raise InvalidInput("fluence", "a rotated affine", "axes along x, y and z")
    lines = []
    for axis, (first, step) in enumerate(zip(affine[:3, 3], steps, strict=True)):
        line = unit * (first + step * np.arange(values.shape[axis]))
        if step < 0:
            values, line = np.flip(values, axis), line[::-1]
        lines.append(line)
    values = values[None] if values.ndim == 3 else np.moveaxis(values, -1, 0)
    return _checked(path, values, given or _stated(image), VoxelAxes(*lines))


def _stated(image: Any) -> tuple[float, ...]:
    """Return the wavelengths in a header extension as :func:`.export_series` writes it; () without one."""
    for extension in image.header.extensions:
        try:
            said = json.loads(bytes(extension.get_content()).rstrip(b"\0"))
            return tuple(1e-9 * float(each) for each in said["ExcitationWavelength"])
        except (ValueError, KeyError, TypeError):
            continue
    return ()


def _checked(path: Path, values: NDArray[Any], lights: tuple[float, ...], axes: VoxelAxes | None) -> FluenceMap:
    """Return the map after validation of its wavelengths and axes."""
    if len(values) > 1 and not lights:
        allowed = "wavelengths in the file (excitation_m, wavelength_nm), or stated, one for each map"
        raise InvalidInput("fluence", f"{len(values)} maps without wavelengths", allowed)
    if lights and len(values) not in (1, len(lights)):
        raise InvalidInput("fluence", f"{len(values)} maps for {len(lights)} wavelengths", "one for each")
    if axes is not None:
        lines = (axes.x, np.zeros(1) if axes.y is None else axes.y, axes.z)
        for name, line, count in zip("xyz", lines, values.shape[1:], strict=True):
            if count not in (1, len(line)) or not (np.diff(line) > 0).all():
                raise InvalidInput(f"fluence.{name}", f"{len(line)} coordinates", f"{count}, rising, in m")
    return FluenceMap(values, lights if len(values) > 1 else (), axes)


def _as_4d(values: NDArray[Any]) -> NDArray[Any]:
    """Return (wavelengths, x, y, z) of an array that may lack y."""
    if values.ndim == 3:
        values = values[:, :, None]
    if values.ndim != 4:
        raise InvalidInput("fluence", f"an array of shape {values.shape}", "axes x, y, z for each wavelength")
    return values


def _check_size(path: Path, array: Any, count: int = 1) -> None:
    size = 8 * count * int(np.prod(array.shape, dtype=np.float64))
    if size > LARGEST:
        raise InvalidInput("fluence", f"{path.name} of {size / 1e9:.3g} GB", f"at most {LARGEST / 1e9:.2g} GB")
