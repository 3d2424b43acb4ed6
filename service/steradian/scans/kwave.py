"""Recordings simulated with k-Wave, as .npz archives.

Expected arrays: ``p`` (time, y, z), the pressure on a full square grid of sensors, or (time, y) on a line of them;
``dt`` in seconds; ``dx`` in metres; optionally ``c`` in metres per second. k-Wave's lateral axes y and z become our
x and y; its depth axis x is our z.
"""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from steradian.errors import DamagedFile
from steradian.scans.recording import Recording


def read_kwave(path: Path) -> Recording:
    """Read a k-Wave recording on a square grid or a line of sensors.

    Sensor j of N lies at (j − N//2)·dx; the aperture, one lateral period, is N·dx.

    Raises
    ------
    DamagedFile
        When the archive is truncated or an array is missing or of another shape.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            missing = [name for name in ("p", "dt", "dx") if name not in archive.files]
            if missing:
                raise DamagedFile(f"{path} has no array {missing[0]!r}; expected p (time, y, z), dt (s) and dx (m)")
            pressure = archive["p"]
            interval, pitch = float(archive["dt"]), float(archive["dx"])
            speed = float(archive["c"]) if "c" in archive.files else None
    except (OSError, ValueError, TypeError, zipfile.BadZipFile) as error:
        raise DamagedFile(f"{path} cannot be read as a k-Wave recording: {error}") from error
    if pressure.ndim not in (2, 3) or pressure.shape[1] != pressure.shape[-1]:
        raise DamagedFile(f"{path}: p has shape {pressure.shape}; expected (time, N, N) or (time, N)")
    side, lateral = pressure.shape[1], pressure.ndim - 1
    line = (np.arange(side) - side // 2) * pitch
    grid = np.meshgrid(*[line] * lateral, indexing="ij")
    return Recording(
        traces=np.ascontiguousarray(pressure.reshape(len(pressure), -1).T),
        scale=1.0,
        positions=np.column_stack([axis.ravel() for axis in grid]),
        weights=None,
        sampling_interval=interval,
        sound_speed=speed,
        aperture=side * pitch,
        time_zero=0.0,
        grid=side,
        depth=None,
        planned=side**lateral,
        provenance={"source": path.name},
    )
