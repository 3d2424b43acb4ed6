"""HDF5 schema of scan files, version 1; ``docs/scan-file.md`` describes it in full.

::

    /                           attributes: format, schema_version, scan_id, created, software, driver, scanner,
                                scanner_model, simulated, tuning_map, geometry_crc32c, source (JSON; imported scans)
    /mask                       attributes: id, aperture_m, sensed_area_m2 (m for a line), depth_m, offset_m (absent if
                                none), arrangement (JSON)
        positions (M, 2) f8     x, y in metres, centred on the aperture
        weights   (M,)   f8     areas in m², sum = sensed_area_m2
        outline   (V, 2) f8     corners of the sensed area; absent where not known
    /plan                       attributes: id, pulse_rate_hz, averages, samples, sampling_interval_s,
                                            sound_speed_m_s, order, time_zero_s, frames, document (JSON),
                                            stages (JSON; of a scan in stages)
        visit     (M,)   i8     indices of points in the order of interrogation
        wavelengths (M,) f8     bias wavelengths in m; absent when the scanner has its own map
        beams     (B, 2) f8     where each interrogation beam is beside the first one, in m; absent with one beam
        beam      (M,)   u1     which of them measures each point: B points in a row are a place, and share their shots
        frame_excitation (F,) f8  excitation wavelength of each frame in m; 0: as the laser stood
    /alines                     row f·M + m belongs to frame f and point m of the mask, whatever the order of visit
        samples   (F·M, N_t) i2 digitised pressure; multiply by scale for the pressure unit; f4 where an import was
                                not of 16-bit integers
        status    (F·M,) u1     0 = missing, 1 = stored
        crc32c    (F·M,) u4     of the row: its samples and its columns
        scale, energy, wavelength_m, fire_time_s, quality, shot, averages, time_zero_s, dc_v, gain_db   (F·M,)
    /run                        what the acquisition needs to continue
        queue     (F·M,) i8     rows last given to the scanner, in order
        upload    (5,)   i8     how many of them, tag of that upload, shots fired before it for this scan and by the
                                laser in all, CRC-32C of queue and these
        reference (4,)   f8     point, bias wavelength (m), sensitivity (V/m), reflectivity (V) when the scan began
    /fired        scalar i8     shots the scanner has fired for this scan

Every dataset has its full size, and its place in the file, from the start. A scan therefore only overwrites bytes
inside existing datasets and never touches the file's own bookkeeping: whatever kills the scan leaves a valid file.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from steradian.core.exceptions import DamagedFile

if TYPE_CHECKING:
    import h5py

FORMAT = "steradian-scan"
VERSION = 1
CHUNK_BYTES = 1 << 18

MISSING, STORED = 0, 1

COLUMNS: dict[str, np.dtype[np.generic]] = {
    "crc32c": np.dtype("<u4"),
    "scale": np.dtype("<f4"),
    "energy": np.dtype("<f4"),
    "wavelength_m": np.dtype("<f8"),
    "fire_time_s": np.dtype("<f8"),
    "quality": np.dtype("<u4"),
    "shot": np.dtype("<u4"),
    "averages": np.dtype("<u4"),
    "time_zero_s": np.dtype("<f8"),
    "dc_v": np.dtype("<f4"),
    "gain_db": np.dtype("<f4"),
    "status": np.dtype("<u1"),
}
"""One value per A-line each; ``crc32c`` comes first, ``status`` is written last."""
ROW = np.dtype(list(COLUMNS.items()))
"""A row of the table, packed; its checksum comes first and covers all that follows it."""
FILE_FORMAT_MARKER = COLUMNS["crc32c"].itemsize
"""Bytes of a row that are its checksum."""

SAMPLES = np.dtype("<i2")
EXACT_SAMPLES = np.dtype("<f4")
"""Samples of imported recordings that 16 bits cannot hold."""
SAMPLE_KINDS = (SAMPLES, EXACT_SAMPLES)
FIRED = np.dtype("<i8")
UPLOAD = np.dtype("<i8")
UPLOAD_FIELDS = 5
REFERENCE = np.dtype("<f8")

NOMINAL = "nominal_j"
"""Attribute of the energies: the pulse energy in J that is 1, where the scanner says so."""
UNITS = {
    "energy": "relative to nominal",
    "wavelength_m": "m",
    "fire_time_s": "s since the scanner's boot",
    "time_zero_s": "s after the pulse",
    "dc_v": "V",
    "gain_db": "dB over the usual gain; scale has taken it into account",
}
"""Units of columns, as attributes."""


def check_version(name: Path | str, version: object) -> None:
    """Raise :class:`DamagedFile` for a ``schema_version`` that this program does not read."""
    if version != VERSION:
        raise DamagedFile(f"{name}: schema_version is {version}; allowed: {VERSION}")


def check_format(name: Path | str, file: h5py.File) -> None:
    """Raise :class:`DamagedFile` if an HDF5 file is not a scan file, or has an unknown version."""
    if (kind := file.attrs.get("format")) != FORMAT:
        raise DamagedFile(f"{name} is an HDF5 file, but its format is {kind!r}; expected {FORMAT!r}")
    check_version(name, file.attrs.get("schema_version"))
