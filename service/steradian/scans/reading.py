"""Reading scan files, finished or not."""

from __future__ import annotations

from pathlib import Path

import google_crc32c
import h5py
import numpy as np
from numpy.typing import NDArray

from steradian.errors import DamagedFile
from steradian.scans import schema
from steradian.scans.recording import Recording


def read_scan(path: Path) -> Recording:
    """Read the stored A-lines of a scan file; points not measured yet are left out.

    The weights of a partial scan are those of its points, scaled to sum to the aperture's area again.

    Raises
    ------
    DamagedFile
        When the file is truncated, of another kind or newer, or holds no A-line.
    """
    try:
        with h5py.File(path, "r") as file:
            _check_kind(path, file)
            return _read(path, file)
    except (OSError, KeyError) as error:
        raise DamagedFile(f"{path} cannot be read as a scan: {error}") from error


def _check_kind(path: Path, file: h5py.File) -> None:
    kind, version = file.attrs.get("format"), file.attrs.get("schema_version")
    if kind != schema.FORMAT:
        raise DamagedFile(f"{path} is an HDF5 file, but its format is {kind!r}; expected {schema.FORMAT!r}")
    if version != schema.VERSION:
        raise DamagedFile(f"{path} has schema version {version}; this program reads {schema.VERSION}")


def _read(path: Path, file: h5py.File) -> Recording:
    alines, mask, plan = file["alines"], file["mask"], file["plan"]
    stored = np.flatnonzero(np.asarray(alines["status"]) == schema.STORED)
    traces = np.asarray(alines["samples"])[stored]
    whole = _intact(traces, np.asarray(alines["crc32c"])[stored])
    stored, traces = stored[whole], traces[whole]
    if not len(stored):
        raise DamagedFile(f"{path} holds no A-line yet")
    aperture = float(mask.attrs["aperture_m"])
    weights = np.asarray(mask["weights"], dtype=np.float64)
    area = weights.sum()
    return Recording(
        traces=traces,
        scale=np.asarray(alines["scale"])[stored],
        positions=np.asarray(mask["positions"], dtype=np.float64)[stored],
        weights=weights[stored] * (area / weights[stored].sum()),
        sampling_interval=float(plan.attrs["sampling_interval_s"]),
        sound_speed=float(plan.attrs["sound_speed_m_s"]),
        aperture=aperture,
        time_zero=float(plan.attrs["time_zero_s"]),
        grid=None,
        depth=float(mask.attrs["depth_m"]) if "depth_m" in mask.attrs else None,
        planned=len(mask["weights"]),
        provenance={
            "scan_id": str(file.attrs["scan_id"]),
            "plan_id": str(plan.attrs["id"]),
            "mask_id": str(mask.attrs["id"]),
            "scanner": str(file.attrs["scanner"]),
            "simulated": str(bool(file.attrs["simulated"])),
        },
    )


def _intact(traces: NDArray[np.int16], checksums: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Tell which rows match their checksum: a power cut may leave a row that was never acknowledged half written."""
    return np.array(
        [google_crc32c.value(row.tobytes()) == crc for row, crc in zip(traces, checksums, strict=True)], bool
    )
