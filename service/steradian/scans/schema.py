"""Layout of a scan file, version 1.

::

    /                         attributes: format, schema_version, scan_id, created, software, scanner, simulated
    /mask                     attributes: id, aperture_m, depth_m (absent if none), arrangement (JSON)
        positions (M, 2) f8   x, y in metres, centred on the aperture
        weights   (M,)   f8   areas in m², sum = aperture²
    /plan                     attributes: id, pulse_rate_hz, averages, samples, sampling_interval_s,
                                          sound_speed_m_s, order, time_zero_s
        visit     (M,)   i8   indices of points in the order of interrogation
    /alines                   row m belongs to point m of the mask, whatever the order of interrogation
        samples   (M, N_t) i2 digitised pressure; multiply by scale for the pressure unit
        status    (M,)   u1   0 = missing, 1 = stored
        crc32c    (M,)   u4   of the row of samples, little-endian
        scale, energy, wavelength_m, fire_time_s, quality, shot   (M,)
    /fired        scalar i8   shots the scanner has fired for this scan

Every dataset has its full size, and its place in the file, from the start. A scan therefore only overwrites bytes
inside existing datasets and never touches the file's own bookkeeping: whatever kills the scan leaves a valid file.
"""

from __future__ import annotations

import numpy as np

FORMAT = "steradian-scan"
VERSION = 1
CHUNK_BYTES = 1 << 18

MISSING, STORED = 0, 1

COLUMNS: dict[str, np.dtype[np.generic]] = {
    "status": np.dtype("<u1"),
    "crc32c": np.dtype("<u4"),
    "scale": np.dtype("<f4"),
    "energy": np.dtype("<f4"),
    "wavelength_m": np.dtype("<f8"),
    "fire_time_s": np.dtype("<f8"),
    "quality": np.dtype("<u4"),
    "shot": np.dtype("<u4"),
}
"""One value per A-line each; ``status`` is written last."""

SAMPLES = np.dtype("<i2")
FIRED = np.dtype("<i8")
