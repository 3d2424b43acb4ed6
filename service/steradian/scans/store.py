"""The A-line store: durable appends into a scan file that is valid at every moment.

The HDF5 library makes the file once, with every dataset allocated at its full size, and closes it. Appending then
overwrites rows in their places and ends with ``fdatasync``; nothing of HDF5's own structure
changes, so neither a kill nor a power cut can damage it, and any HDF5 reader may look at a running scan.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

import google_crc32c
import h5py
import numpy as np
from numpy.typing import NDArray

from steradian import __version__
from steradian.errors import Conflict, InvalidInput
from steradian.plans import ScanPlan
from steradian.scans import schema


class StorableAline(Protocol):
    """What the store needs of an A-line (``fabry_perot.ALine`` has it); ``point`` counts in visit order."""

    @property
    def point(self) -> int: ...  # noqa: D102
    @property
    def samples(self) -> NDArray[np.int16]: ...  # noqa: D102
    @property
    def scale(self) -> float: ...  # noqa: D102
    @property
    def energy(self) -> float: ...  # noqa: D102
    @property
    def wavelength_m(self) -> float: ...  # noqa: D102
    @property
    def fire_time_s(self) -> float: ...  # noqa: D102
    @property
    def quality(self) -> int: ...  # noqa: D102
    @property
    def shot(self) -> int: ...  # noqa: D102


def create_scan_file(
    path: Path, plan: ScanPlan, *, scan_id: str = "", scanner: str = "", simulated: bool = False
) -> None:
    """Make an empty scan file of its final size.

    It is built under another name and renamed when it is whole, so ``path`` never holds half a file.

    Raises
    ------
    Conflict
        When ``path`` exists.
    OSError
        When the disk cannot hold the whole scan (the space is reserved here, before a pulse is fired).
    """
    if path.exists():
        raise Conflict(f"{path} exists; choose another name or remove it")
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(path.name + ".new")
    try:
        with h5py.File(draft, "w") as file:
            file.attrs.update(_origin(scan_id, scanner, simulated))
            _write_mask_and_plan(file, plan)
            _allocate(file, plan.mask.count, plan.samples)
        with draft.open("r+b") as raw:
            _reserve_disk(raw.fileno(), draft.stat().st_size)
            os.fsync(raw.fileno())
        draft.replace(path)
        _sync_folder(path.parent)
    finally:
        draft.unlink(missing_ok=True)


class AlineStore:
    """Durable appends into a scan file; one writer at a time.

    Parameters
    ----------
    path
        A file made by :func:`create_scan_file`.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with h5py.File(path, "r") as file:
            samples = file["alines/samples"]
            self.count, self.samples = samples.shape
            self._visit = np.asarray(file["plan/visit"])
            self._chunk_rows = samples.chunks[0]
            self._chunk_offsets = [
                samples.id.get_chunk_info_by_coord((row, 0)).byte_offset
                for row in range(0, self.count, self._chunk_rows)
            ]
            self._columns = {name: file["alines"][name].id.get_offset() for name in schema.COLUMNS}
            self._fired_offset = file["fired"].id.get_offset()
            self._stored = np.asarray(file["alines/status"]) == schema.STORED
        self._file = path.open("r+b", buffering=0)

    @property
    def stored(self) -> int:
        """Number of A-lines stored so far."""
        return int(self._stored.sum())

    def append(self, alines: Iterable[StorableAline]) -> None:
        """Store A-lines and return when they are on the disk; only then may they be acknowledged.

        Raises
        ------
        InvalidInput
            When an A-line has another length or an unknown point.
        OSError
            When the disk fails; A-lines of this call may then be stored or not, earlier ones are.
        """
        for aline in alines:
            self._write(aline)
        _sync_data(self._file.fileno())

    def set_fired(self, shots: int) -> None:
        """Note how many shots the scanner says it has fired."""
        self._overwrite(self._fired_offset, np.asarray(shots, schema.FIRED).tobytes())

    def close(self) -> None:
        """Flush and close; the file is valid without it."""
        if not self._file.closed:
            os.fsync(self._file.fileno())
            self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _write(self, aline: StorableAline) -> None:
        if not 0 <= aline.point < self.count:
            raise InvalidInput("point", aline.point, f"0 to {self.count - 1}")
        row = np.ascontiguousarray(aline.samples, dtype=schema.SAMPLES)
        if row.shape != (self.samples,):
            raise InvalidInput("samples", f"an A-line of shape {row.shape}", f"({self.samples},)")
        place = int(self._visit[aline.point])
        data = row.tobytes()
        chunk, within = divmod(place, self._chunk_rows)
        self._overwrite(self._chunk_offsets[chunk] + within * len(data), data)
        values: dict[str, Any] = {
            "crc32c": google_crc32c.value(data),
            "scale": aline.scale,
            "energy": aline.energy,
            "wavelength_m": aline.wavelength_m,
            "fire_time_s": aline.fire_time_s,
            "quality": aline.quality,
            "shot": aline.shot,
            "status": schema.STORED,
        }
        for name, value in values.items():
            kind = schema.COLUMNS[name]
            self._overwrite(self._columns[name] + place * kind.itemsize, np.asarray(value, kind).tobytes())
        self._stored[place] = True

    def _overwrite(self, offset: int, data: bytes) -> None:
        self._file.seek(offset)
        while data:  # an unbuffered write may be short
            data = data[self._file.write(data) :]


def _origin(scan_id: str, scanner: str, simulated: bool) -> dict[str, Any]:
    return {
        "format": schema.FORMAT,
        "schema_version": schema.VERSION,
        "scan_id": scan_id,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "software": f"steradian {__version__}",
        "scanner": scanner,
        "simulated": int(simulated),
    }


def _write_mask_and_plan(file: h5py.File, plan: ScanPlan) -> None:
    mask = plan.mask
    group = file.create_group("mask")
    group.attrs.update({"id": mask.id, "aperture_m": mask.aperture, "arrangement": json.dumps(mask.arrangement)})
    if mask.depth is not None:
        group.attrs["depth_m"] = mask.depth
    group.create_dataset("positions", data=mask.positions).attrs.update({"units": "m", "axes": "point, (x, y)"})
    group.create_dataset("weights", data=mask.weights).attrs["units"] = "m^2"
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
            "time_zero_s": 0.0,
        }
    )
    group.create_dataset("visit", data=plan.visit)


def _allocate(file: h5py.File, count: int, samples: int) -> None:
    group = file.create_group("alines")
    rows = min(count, max(1, schema.CHUNK_BYTES // (samples * schema.SAMPLES.itemsize)))
    _reserve(group, "samples", (count, samples), schema.SAMPLES, (rows, samples))
    group["samples"].attrs.update({"axes": "point, time", "units": "counts; times scale for the pressure unit"})
    for name, kind in schema.COLUMNS.items():
        _reserve(group, name, (count,), kind, None)
    _reserve(file, "fired", (), schema.FIRED, None)


def _reserve(
    group: h5py.Group, name: str, shape: tuple[int, ...], kind: np.dtype[Any], chunk: tuple[int, ...] | None
) -> None:
    """Create a dataset whose bytes have their place in the file at once (zeros, from the reserved space)."""
    made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    made.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    if chunk is not None:
        made.set_chunk(chunk)
    space = h5py.h5s.create_simple(shape) if shape else h5py.h5s.create(h5py.h5s.SCALAR)
    h5py.h5d.create(group.id, name.encode(), h5py.h5t.py_create(kind), space, made)


def _reserve_disk(file: int, size: int) -> None:
    """Turn the file's holes into reserved space, so that a full disk shows now and not in the middle of a scan."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file, 0, size)


def _sync_data(file: int) -> None:
    """Wait until the file's data are on the disk; its size and bookkeeping never change while a scan runs."""
    getattr(os, "fdatasync", os.fsync)(file)


def _sync_folder(folder: Path) -> None:
    """Make a rename in ``folder`` survive a power cut."""
    if os.name != "posix":  # elsewhere a folder cannot be opened, and renames are journalled
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
