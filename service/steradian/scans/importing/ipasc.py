"""Import of IPASC HDF5, the format of the International Photoacoustic Standardisation Consortium.

``binary_time_series_data`` is [detector, sample, wavelength, frame]; ``meta_data`` holds the tags of the acquisition,
``meta_data_device`` a group for each detector. All values are datasets in SI units. Our own files add tags that the
standard lacks, under names that begin with ``custom_``.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import product
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import DamagedFile, InvalidInput
from steradian.core.progress import Progress
from steradian.scans.importing import untrusted
from steradian.scans.importing.aline_blocks import Hdf5TraceBlocks
from steradian.scans.importing.description import Description
from steradian.scans.importing.geometry import refuse_sideways
from steradian.scans.importing.import_remarks import remark
from steradian.scans.importing.source import Metadata, RecordingSource, make_source

FORMAT = "ipasc"
NANOMETRES = (200.0, 3000.0)
"""Wavelengths of light as numbers of nm."""
SOME = 64
"""Detectors whose directions are looked at."""
EVERY = 2000
"""Detectors between two reports."""
SERIES, ACQUISITION, DEVICE = "binary_time_series_data", "meta_data", "meta_data_device"
TIME_ZERO, WEIGHTS, DEPTH, APERTURE, SIMULATED, ENERGY, QUALITY = (
    "custom_t0",
    "custom_detector_weights",
    "custom_point_of_interest_depth",
    "custom_aperture",
    "custom_simulated",
    "custom_pulse_energy",
    "custom_quality_flags",
)
"""Our tags beside the standard's: from laser pulse to first sample (s), areas (m²), distance and side (m), 0 or 1, and
[detector, wavelength, frame] what the A-lines are not corrected for."""


@contextmanager
def open_ipasc(path: Path, said: Description, note: Progress | None = None) -> Iterator[RecordingSource]:
    """Open an IPASC file as a recording source; the description may select one of several wavelengths.

    Raises
    ------
    DamagedFile, InvalidInput
        When it is damaged or refused, or lacks what is needed.
    """
    with untrusted.open_untrusted(path) as file:
        series = untrusted.dataset(file, SERIES, most_bytes=untrusted.TRACE_BYTES)
        table = _table(series, said)
        points = _positions(file, table.points, note)
        refuse_sideways(points, _directions(file))
        stated = replace(_stated(file, points, _excitation(file, series, said)), energies=_energies(file, series, said))
        yield make_source(FORMAT, table, stated, said, path.name)


def _table(series: h5py.Dataset, said: Description) -> Hdf5TraceBlocks:
    if series.ndim not in (2, 3, 4):
        raise DamagedFile(f"{SERIES} has the shape {series.shape}; expected (detectors, samples, wavelengths, frames)")
    choices = []
    for name, count, chosen in zip(
        ("wavelength", "frame"), series.shape[2:], (said.wavelength, said.frame), strict=False
    ):
        if chosen is not None and chosen >= count:
            raise InvalidInput(name, chosen, f"0 to {count - 1}; the file holds {count}")
        choices.append(range(count) if chosen is None else (chosen,))
    return Hdf5TraceBlocks(series, tuple(product(*choices)))


def _stated(file: h5py.File, points: NDArray[np.float64], excitation: tuple[float, ...]) -> Metadata:
    rate = untrusted.number(file, f"{ACQUISITION}/ad_sampling_rate")
    if rate is None or not rate > 0:
        raise DamagedFile(f"{untrusted.name_of(file)} has no positive sampling rate ({ACQUISITION}/ad_sampling_rate)")
    weights = None
    if f"{ACQUISITION}/{WEIGHTS}" in file:
        weights = untrusted.array(file, f"{ACQUISITION}/{WEIGHTS}").astype(np.float64).reshape(-1)
    return Metadata(
        points=points,
        bounds=_field_of_view(file),
        weights=weights,
        aperture=untrusted.number(file, f"{ACQUISITION}/{APERTURE}"),
        sampling_interval=1 / rate,
        sound_speed=_sound_speed(file),
        time_zero=untrusted.number(file, f"{ACQUISITION}/{TIME_ZERO}") or 0.0,
        depth=untrusted.number(file, f"{ACQUISITION}/{DEPTH}"),
        excitation=excitation,
        simulated=bool(untrusted.number(file, f"{ACQUISITION}/{SIMULATED}")),
    )


def _excitation(file: h5py.File, series: h5py.Dataset, said: Description) -> tuple[float, ...]:
    """Return the excitation wavelengths in m, if the file states one for each imported frame; else ()."""
    name, count = f"{ACQUISITION}/acquisition_wavelengths", series.shape[2] if series.ndim > 2 else 1
    if name not in file:
        return ()
    found = untrusted.array(file, name, most_bytes=1 << 16).astype(np.float64).reshape(-1)
    if len(found) != count:
        return ()
    if len(found) and ((found >= NANOMETRES[0]) & (found <= NANOMETRES[1])).all():
        remark("wavelengths of the light were taken in nm: in the standard's metres they are implausible")
        found = found / 1e9
    return tuple(map(float, found if said.wavelength is None else found[[said.wavelength]]))


def _energies(file: h5py.File, series: h5py.Dataset, said: Description) -> NDArray[np.float64] | None:
    """Return the pulse energies (frames, detectors), which exports of this program state; else ``None``."""
    name, shape = f"{ACQUISITION}/{ENERGY}", (series.shape[0], *series.shape[2:])
    if name not in file or file[name].shape != shape:
        return None
    found = untrusted.array(file, name).astype(np.float64).reshape(shape[0], -1, shape[2] if len(shape) > 2 else 1)
    found = found[:, slice(None) if said.wavelength is None else [said.wavelength]]
    found = found[:, :, slice(None) if said.frame is None else [said.frame]]
    return found.reshape(shape[0], -1).T


def _sound_speed(file: h5py.File) -> float | None:
    """Return the speed of sound if the file states a single number; ``None`` for a map."""
    name = f"{ACQUISITION}/speed_of_sound"
    found = file.get(name)
    if not isinstance(found, h5py.Dataset) or found.size != 1 or found.dtype.kind not in "iuf":
        return None
    return untrusted.number(file, name)


def _positions(file: h5py.File, count: int, note: Progress | None) -> NDArray[np.float64]:
    """Return the positions (M, 3) of the detectors, sorted by name (numerically where names are numbers)."""
    group = file.get(f"{DEVICE}/detectors")
    names = list(group) if isinstance(group, h5py.Group) else []
    if len(names) != count:
        raise DamagedFile(f"{untrusted.name_of(file)} describes {len(names)} detectors, but holds {count} A-lines")
    if all(name.isdecimal() and name.isascii() for name in names):
        names.sort(key=int)
    found = np.empty((count, 3))
    for index, name in enumerate(names):
        if note and index % EVERY == 0:
            note("detectors", index, count)
        if not untrusted.read_plain(group, f"{name}/detector_position", found[index]):
            place = untrusted.array(file, f"{DEVICE}/detectors/{name}/detector_position", most_bytes=1 << 10)
            if place.size != 3:
                raise DamagedFile(
                    f"{untrusted.name_of(file)}: detector {name} has a position of {place.size} numbers; expected 3"
                )
            found[index] = place.reshape(-1)
    return found


def _directions(file: h5py.File) -> NDArray[np.float64]:
    """Return the orientations (K, 3) of a sample of the detectors, if the file states them."""
    group = file[f"{DEVICE}/detectors"]
    names = list(group)
    found = []
    for name in names[:: max(1, len(names) // SOME)]:
        place = f"{DEVICE}/detectors/{name}/detector_orientation"
        if place in file:
            value = untrusted.array(file, place, most_bytes=1 << 10).astype(np.float64).reshape(-1)
            if value.size == 3:
                found.append(value)
    return np.array(found, np.float64).reshape(-1, 3)


def _field_of_view(file: h5py.File) -> NDArray[np.float64] | None:
    name = f"{DEVICE}/general/field_of_view"
    if name not in file:
        return None
    limits = untrusted.array(file, name, most_bytes=1 << 10).astype(np.float64).reshape(-1)
    return limits.reshape(3, 2) if limits.size == 6 and np.isfinite(limits).all() else None
