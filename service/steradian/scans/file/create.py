"""Creation of scan files with all datasets preallocated."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import google_crc32c
import numpy as np
from numpy.typing import NDArray

from steradian._version import __version__
from steradian.core.atomic_files import sync_folder
from steradian.core.exceptions import Conflict, DiskFull
from steradian.plans import ScanPlan
from steradian.scans.file import schema
from steradian.scans.file.measurement_order import ScanProgram

if TYPE_CHECKING:
    import h5py

FREE_SPACE_MARGIN = 1.2
"""Free space below this many times a scan's need is worth a warning."""
DISK_FULL_ERRNOS = frozenset({errno.ENOSPC, errno.EDQUOT})


def create_scan_file(
    path: Path,
    plan: ScanPlan,
    *,
    scan_id: str = "",
    scanner: str = "",
    simulated: bool = False,
    scanner_model: str = "",
    sample_kind: np.dtype[Any] = schema.SAMPLES,
    time_zero: float = 0.0,
    created: str | None = None,
    visit: NDArray[np.int64] | None = None,
    bias: NDArray[np.float64] | None = None,
    pulse_energy: float = 0.0,
    film: str = "",
) -> None:
    """Create an empty scan file of its final size for a plan.

    It is built under another name and renamed when it is whole, so ``path`` never holds half a file.

    Parameters
    ----------
    path
        Where.
    plan
        What is to be measured.
    scan_id
        Identifier of the scan, if it has one.
    scanner, scanner_model, simulated
        Serial number and model of the scanner, and whether it is a simulation.
    sample_kind
        16-bit integers, or float32 for an import.
    time_zero
        Time in seconds from the laser pulse to the first sample.
    created
        When it was measured (ISO 8601); now, if not given.
    visit
        (M,) points in the order of interrogation where that is not the plan's own.
    bias
        (M,) wavelengths in m that were set at the points, if there were any, where they are not the plan's own.
    pulse_energy
        Nominal energy of a pulse in J, to which the A-lines' is relative; 0: not known.
    film
        Response of a simulated scanner's film, see :class:`fabry_perot.Capabilities`; "": not known.

    Raises
    ------
    Conflict
        When ``path`` exists.
    DiskFull
        When the disk cannot hold the whole scan (the space is reserved here, before a pulse is fired).
    """
    import h5py

    if path.exists():
        raise Conflict(f"{path} exists; choose another name or remove it")
    path.parent.mkdir(parents=True, exist_ok=True)
    check_free_space(path.parent, scan_file_bytes(plan, sample_kind))
    draft = path.with_name(path.name + ".new")
    try:
        with h5py.File(draft, "w") as file:
            file.attrs.update(_origin(plan, scan_id, scanner, scanner_model, simulated, created))
            if film:
                file.attrs["film"] = film
            _write_mask(file, plan)
            _write_plan(file, plan, time_zero, visit, bias)
            file.attrs["geometry_crc32c"] = geometry_checksum(file)
            _allocate(file, plan.aline_count, plan.samples, sample_kind)
            if pulse_energy:
                file["alines/energy"].attrs[schema.NOMINAL] = pulse_energy
        with draft.open("r+b") as raw:
            _preallocate(raw.fileno(), draft.stat().st_size)
            os.fsync(raw.fileno())
        draft.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        if is_disk_full_error(error):
            need = scan_file_bytes(plan, sample_kind) / 1e6
            raise DiskFull(f"{path} needs {need:.1f} MB and the disk is full") from error
        raise
    finally:
        draft.unlink(missing_ok=True)


def scan_file_bytes(plan: ScanPlan, sample_kind: np.dtype[Any] = schema.SAMPLES) -> int:
    """Return the size in bytes of a plan's scan file after all stages, rounded up by a few kilobytes at most."""
    alines = plan.frame_count * plan.most_points
    rows = _chunk_rows(alines, plan.samples, sample_kind)
    padded = -(-alines // rows) * rows
    columns = sum(kind.itemsize for kind in schema.COLUMNS.values()) + schema.UPLOAD.itemsize
    geometry = plan.most_points * (2 * 8 + 4 * 8) + 8 * plan.frame_count
    return padded * plan.samples * sample_kind.itemsize + alines * columns + geometry + 65_536


def check_free_space(folder: Path, need: int) -> str | None:
    """Raise DiskFull if a scan does not fit on the disk of a folder; return a warning if little space is left.

    Returns a warning when little space is left.

    Raises
    ------
    DiskFull
        Only when it cannot fit.
    """
    free = shutil.disk_usage(folder).free
    if free < need:
        raise DiskFull(f"the scan needs {need / 1e6:.1f} MB, the disk of {folder} has {free / 1e6:.1f} MB free")
    if free < FREE_SPACE_MARGIN * need:
        return f"the scan needs {need / 1e6:.1f} MB of the {free / 1e6:.1f} MB free on the disk of {folder}"
    return None


def is_disk_full_error(error: OSError) -> bool:
    """Return whether an OSError means that the disk or the user's quota is full."""
    return error.errno in DISK_FULL_ERRNOS


def tuning_map_hash(plan: ScanPlan) -> str:
    """Return the SHA-256 hash of a plan's bias wavelengths; "scanner" if the scanner's own map is used."""
    if plan.wavelengths is None:
        return "scanner"
    return hashlib.sha256(np.ascontiguousarray(plan.wavelengths, dtype="<f8").tobytes()).hexdigest()


GEOMETRY = (
    *(f"mask/{name}" for name in ("positions", "weights")),
    *(f"plan/{name}" for name in ("visit", "wavelengths", "frame_excitation")),
    "mask/outline",
    "plan/bias",
    *(f"plan/{name}" for name in ("beams", "beam")),
)
"""All that says what the A-lines mean, in the order of its checksum."""


def geometry_checksum(file: h5py.File) -> int:
    """Return the CRC-32C of the file's geometry: positions, weights, order, wavelengths and outline."""
    crc = 0
    for name in GEOMETRY:
        if name in file:
            crc = google_crc32c.extend(crc, np.ascontiguousarray(file[name]).tobytes())
    return int(crc)


def _origin(
    plan: ScanPlan, scan_id: str, scanner: str, model: str, simulated: bool, created: str | None
) -> dict[str, Any]:
    return {
        "format": schema.FORMAT,
        "schema_version": schema.VERSION,
        "scan_id": scan_id,
        "created": created or datetime.now(UTC).isoformat(timespec="seconds"),
        "software": f"steradian {__version__}",
        "scanner": scanner,
        "scanner_model": model,
        "simulated": int(simulated),
        "tuning_map": tuning_map_hash(plan),
    }


def _write_mask(file: h5py.File, plan: ScanPlan) -> None:
    mask = plan.mask
    group = file.create_group("mask")
    group.attrs.update({"id": mask.id, "aperture_m": mask.aperture, "arrangement": json.dumps(mask.arrangement)})
    group.attrs["sensed_area_m2"] = mask.sensed_area
    if mask.depth is not None:
        group.attrs["depth_m"] = mask.depth
    if mask.offset != (0.0, 0.0):
        group.attrs["offset_m"] = mask.offset
    group.create_dataset("positions", data=mask.positions).attrs.update({"units": "m", "axes": "point, (x, y)"})
    group.create_dataset("weights", data=mask.weights).attrs["units"] = "m^2"
    if mask.outline is not None:
        group.create_dataset("outline", data=mask.outline).attrs.update({"units": "m", "axes": "corner, (x, y)"})


def _write_plan(
    file: h5py.File,
    plan: ScanPlan,
    time_zero: float,
    visit: NDArray[np.int64] | None,
    bias: NDArray[np.float64] | None,
) -> None:
    group = file.create_group("plan")
    group.attrs.update(
        {
            "id": plan.id,
            "pulse_rate_hz": plan.pulse_rate,
            "averages": plan.averages,
            "samples": plan.samples,
            "sampling_interval_s": plan.sampling_interval,
            "sound_speed_m_s": plan.sound_speed,
            "order": str(plan.order),
            "time_zero_s": time_zero,
            "frames": plan.frame_count,
            "gate": plan.gate,
            "document": plan.model_dump_json(exclude={"mask", "wavelengths"}),
        }
    )
    group.create_dataset("visit", data=ScanProgram.of_plan(plan).visit if visit is None else visit)
    if plan.wavelengths is not None:
        group.create_dataset("wavelengths", data=plan.wavelengths).attrs["units"] = "m"
        group.create_dataset("bias", data=plan.bias if bias is None else bias).attrs["units"] = "m"
    if plan.beams:
        group.create_dataset("beams", data=np.asarray(plan.beams)).attrs.update({"units": "m", "axes": "beam, (x, y)"})
        group.create_dataset("beam", data=(np.arange(plan.mask.count) % plan.beam_count).astype("<u1"))
    group.create_dataset("frame_excitation", data=np.asarray(plan.frame_excitation)).attrs["units"] = "m"


_PIECE = 1 << 20


def _chunk_rows(count: int, samples: int, sample_kind: np.dtype[Any]) -> int:
    """Return the number of rows in an HDF5 chunk, chosen so that the last chunk is nearly full."""
    most = max(1, schema.CHUNK_BYTES // (samples * sample_kind.itemsize))
    return -(-count // -(-count // most))


def _allocate(file: h5py.File, count: int, samples: int, sample_kind: np.dtype[Any]) -> None:
    group = file.create_group("alines")
    _create_preallocated(
        group, "samples", (count, samples), sample_kind, (_chunk_rows(count, samples, sample_kind), samples)
    )
    group["samples"].attrs.update({"axes": "frame × point, time", "units": "counts; times scale for the pressure unit"})
    for name, kind in schema.COLUMNS.items():
        _create_preallocated(group, name, (count,), kind, None)
        if name in schema.UNITS:
            group[name].attrs["units"] = schema.UNITS[name]
    group = file.create_group("run")
    _create_preallocated(group, "queue", (count,), schema.UPLOAD, None)
    _create_preallocated(group, "upload", (schema.UPLOAD_FIELDS,), schema.UPLOAD, None)
    _create_preallocated(group, "reference", (4,), schema.REFERENCE, None)
    _create_preallocated(file, "fired", (), schema.FIRED, None)


def _create_preallocated(
    group: h5py.Group, name: str, shape: tuple[int, ...], kind: np.dtype[Any], chunk: tuple[int, ...] | None
) -> None:
    """Create an HDF5 dataset whose bytes are allocated in the file at once."""
    import h5py

    made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    made.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    if chunk is not None:
        made.set_chunk(chunk)
    space = h5py.h5s.create_simple(shape) if shape else h5py.h5s.create(h5py.h5s.SCALAR)
    h5py.h5d.create(group.id, name.encode(), h5py.h5t.py_create(kind), space, made)


def _preallocate(file: int, size: int) -> None:
    """Allocate disk space for the holes of the sparse file, so that a full disk fails now and not during a scan.

    What is reserved is written once, too: else each batch of a scan would change the file system's own notes of which
    blocks hold data, and wait for their journal.
    """
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file, 0, size)
    for start in range(0, size, _PIECE):
        data = os.pread(file, _PIECE, start)
        while data:
            written = os.pwrite(file, data, start)
            start, data = start + written, data[written:]  # a write may be short
