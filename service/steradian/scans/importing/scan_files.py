"""Import of scan files of this program from untrusted sources, by rewriting their validated content."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import google_crc32c
import h5py
import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import Cancelled, DamagedFile, InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.core.quantity_ranges import TIME_ZERO
from steradian.plans import ScanPlan
from steradian.scans.file import schema
from steradian.scans.file.aline_metadata import ShotTable
from steradian.scans.file.columns import ATTRIBUTE_BY_COLUMN
from steradian.scans.file.create import geometry_checksum
from steradian.scans.file.source_metadata import MOST_CHARACTERS, SOURCE, parse_origin
from steradian.scans.file.writer import ScanFileWriter, UploadRecord, create_scan_file
from steradian.scans.importing import untrusted
from steradian.scans.importing.aline_blocks import Hdf5TraceBlocks
from steradian.scans.importing.scan_writer import MAX_VALUE, ImportedAline, check_values, split_block
from steradian.scans.importing.untrusted_plan_reader import read_plan

FORMAT = "steradian"
GROUPS = {"mask", "plan", "alines", "run"}
DATASETS = {
    "fired",
    *(f"mask/{name}" for name in ("positions", "weights", "outline")),
    *(f"plan/{name}" for name in ("visit", "wavelengths", "bias", "beams", "beam", "frame_excitation")),
    *(f"alines/{name}" for name in ("samples", *schema.COLUMNS)),
    *(f"run/{name}" for name in ("queue", "upload", "reference")),
}
"""All that a scan file may hold."""
LIMITS = {
    "scale": (0.0, MAX_VALUE),
    "energy": (0.0, 1e6),
    "wavelength_m": (0.0, 1e-4),
    "fire_time_s": (0.0, 1e12),
    "averages": (0.0, 1e6),
    "time_zero_s": (TIME_ZERO.low, TIME_ZERO.high),
    "dc_v": (-1e3, 1e3),
    "gain_db": (-1e3, 1e3),
}
"""Least and most that a column may say of a stored A-line."""
NAME = 1000
"""Characters of a name."""


@dataclass(frozen=True)
class _Scan:
    """Validated metadata of a scan file, without the A-lines."""

    plan: ScanPlan
    visit: NDArray[np.int64]
    bias: NDArray[np.float64] | None
    table: Hdf5TraceBlocks
    rows: ShotTable
    stored: NDArray[np.bool_]
    fired: int


def sanitise_scan(
    source: Path, path: Path, *, progress: Progress | None, cancelled: CancelCheck | None
) -> tuple[int, int]:
    """Copy the validated content of a scan file into a new one; return the numbers of A-lines and samples.

    Nothing is copied that was not read as what it should be. Missing points stay missing: the new file can be
    continued or reconstructed like the old one.

    Raises
    ------
    DamagedFile
        When it holds something refused or unknown, the shapes do not fit each other, or an A-line does not match its
        checksum.
    InvalidInput
        When a value is out of range.
    Cancelled
        When ``cancelled`` said so.
    """
    with untrusted.open_untrusted(source) as file:
        scan = _read(file)
        create_scan_file(
            path,
            scan.plan,
            scan_id=_name(file, "scan_id"),
            scanner=_name(file, "scanner"),
            scanner_model=_name(file, "scanner_model"),
            simulated=bool(untrusted.float_attribute(file, "/", "simulated")),
            sample_kind=scan.table.dtype,
            time_zero=_time_zero(file),
            created=_name(file, "created") or None,
            visit=scan.visit,
            bias=scan.bias,
            pulse_energy=_pulse_energy(file),
            film=_name(file, "film"),
        )
        with ScanFileWriter(path) as store:
            _write(scan, store, progress, cancelled)
            _copy_resume_state(file, scan, store)
            store.record_shot_count(scan.fired)
        if origin := parse_origin(untrusted.text(file, "/", SOURCE, most=MOST_CHARACTERS)):
            with h5py.File(path, "r+") as made:
                made.attrs[SOURCE] = json.dumps(origin)
    return int(scan.stored.sum()), scan.table.samples


@contextmanager
def open_scan(source: Path) -> Iterator[tuple[ScanPlan, Hdf5TraceBlocks, float]]:
    """Open an untrusted scan file for preview; yield its plan, A-lines and time zero (s)."""
    with untrusted.open_untrusted(source) as file:
        scan = _read(file)
        yield scan.plan, scan.table, _time_zero(file)


def _read(file: h5py.File) -> _Scan:
    name = untrusted.name_of(file)
    version = untrusted.float_attribute(file, "/", "schema_version")
    schema.check_version(name, version if version is None or version % 1 else int(version))
    _refuse_unknown(file)
    plan = read_plan(file)
    samples = untrusted.dataset(file, "alines/samples", most_bytes=untrusted.TRACE_BYTES)
    if samples.shape != (plan.aline_count, plan.samples) or samples.dtype not in schema.SAMPLE_KINDS:
        raise DamagedFile(
            f"{name}: alines/samples is {samples.dtype} of the shape {samples.shape}; expected int16 or float32"
            f" of ({plan.aline_count}, {plan.samples})"
        )
    columns = {column: untrusted.array(file, f"alines/{column}") for column in schema.COLUMNS}
    for column, kind in schema.COLUMNS.items():
        if columns[column].shape != (plan.aline_count,) or columns[column].dtype.newbyteorder("<") != kind:
            raise DamagedFile(f"{name}: alines/{column} is not {kind} of ({plan.aline_count},)")
    if not np.isin(columns["status"], (schema.MISSING, schema.STORED)).all():
        raise DamagedFile(f"{name}: alines/status has values other than {schema.MISSING} and {schema.STORED}")
    stored = columns["status"] == schema.STORED
    for column, (least, most) in LIMITS.items():
        _require_range(column, columns[column], stored, least, most)
    if not np.array_equal(untrusted.array(file, "plan/frame_excitation"), plan.frame_excitation):
        raise DamagedFile(f"{name}: plan/frame_excitation differs from the plan")
    beams = untrusted.array(file, "plan/beams") if "plan/beams" in file else np.empty((0, 2))
    if not np.array_equal(beams, np.reshape(plan.beams, (-1, 2))):
        raise DamagedFile(f"{name}: plan/beams differs from the plan")
    visit, bias = _visit(file, plan), _bias(file, plan)
    if untrusted.float_attribute(file, "/", "geometry_crc32c") != geometry_checksum(file):
        raise DamagedFile(f"{name}: positions, weights or order of the points do not match their checksum")
    return _Scan(plan, visit, bias, Hdf5TraceBlocks(samples), ShotTable(columns), stored, _fired(file))


def _refuse_unknown(file: h5py.File) -> None:
    """Raise DamagedFile for unknown groups or datasets in a scan file."""
    for place in _names(file):
        if place not in GROUPS | DATASETS or (place in GROUPS) != isinstance(file[place], h5py.Group):
            raise DamagedFile(f"{untrusted.name_of(file)}: {place} is unknown in a scan file")


def _names(file: h5py.File) -> list[str]:
    """Return the names of all HDF5 objects, down to the depth of a scan file's structure."""
    names = [name.decode(errors="replace") for name in file.id]
    for group in GROUPS.intersection(names):
        if isinstance(file[group], h5py.Group):
            names += [f"{group}/{name.decode(errors='replace')}" for name in file[group].id]
    return names


def _visit(file: h5py.File, plan: ScanPlan) -> NDArray[np.int64]:
    visit = untrusted.array(file, "plan/visit")
    if visit.dtype.kind not in "iu" or not np.array_equal(np.sort(visit, axis=None), np.arange(plan.mask.count)):
        raise DamagedFile(f"{untrusted.name_of(file)}: plan/visit does not name each of {plan.mask.count} points once")
    together = visit.reshape(-1, plan.beam_count)
    if ((together[:, 0] % plan.beam_count != 0) | (np.diff(together, axis=1) != 1).any(axis=1)).any():
        raise DamagedFile(f"{untrusted.name_of(file)}: plan/visit takes the beams of a place apart")
    return visit.astype(np.int64)


def _bias(file: h5py.File, plan: ScanPlan) -> NDArray[np.float64] | None:
    """Read the bias wavelengths that were set; ``None`` where the scanner tunes by its own map."""
    if plan.wavelengths is None and "plan/bias" not in file:
        return None
    bias = untrusted.array(file, "plan/bias")
    if bias.shape != (plan.mask.count,) or bias.dtype.kind != "f" or not ((bias > 0) & (bias < np.inf)).all():
        name = untrusted.name_of(file)
        raise DamagedFile(f"{name}: plan/bias does not name a wavelength of each of {plan.mask.count} points")
    return bias.astype(np.float64)


def _fired(file: h5py.File) -> int:
    fired = untrusted.number(file, "fired")
    if fired is None or not 0 <= fired < 1 << 53:
        raise InvalidInput("fired", fired, "0 to 2⁵³ shots")
    return int(fired)


def _time_zero(file: h5py.File) -> float:
    value = untrusted.float_attribute(file, "plan", "time_zero_s") or 0.0
    return TIME_ZERO.check("time_zero_s", value)


def _pulse_energy(file: h5py.File) -> float:
    value = untrusted.float_attribute(file, "alines/energy", schema.NOMINAL) or 0.0
    if not 0 <= value <= 1e3:
        raise InvalidInput(schema.NOMINAL, value, "0 to 1e3 (J)")
    return value


def _name(file: h5py.File, attribute: str) -> str:
    """Read a text attribute of the root group, without terminal control characters."""
    return "".join(each for each in untrusted.text(file, "/", attribute, most=NAME) or "" if each.isprintable())


def _write(scan: _Scan, store: ScanFileWriter, progress: Progress | None, cancelled: CancelCheck | None) -> None:
    rows, total = np.arange(scan.plan.aline_count), scan.plan.aline_count
    for start, block in scan.table.blocks():
        if cancelled and cancelled():
            raise Cancelled(f"the import was stopped after {start} of {total} A-lines")
        for first, piece in split_block(start, block):
            kept = rows[first : first + len(piece)]
            kept = kept[scan.stored[kept]]
            check_values(piece[kept - first], scan.rows["scale"][kept], kept)
            store.append(_alines(scan, first, piece), rows)
        if progress:
            progress("A-lines", min(start + len(block), total), total)


def _alines(scan: _Scan, first: int, block: NDArray[Any]) -> Iterator[ImportedAline]:
    """Yield the stored A-lines of a block of rows after checksum verification."""
    rows = np.flatnonzero(scan.stored[first : first + len(block)])
    proven = scan.rows.take(first + rows).verify_rows(block[rows])
    if not proven.all():
        raise DamagedFile(f"A-line {first + rows[~proven][0]} does not match its checksum")
    for within in rows.tolist():
        row = first + within
        said = {attribute: scan.rows[name][row].item() for name, attribute in ATTRIBUTE_BY_COLUMN.items()}
        yield ImportedAline(row, block[within], **said)


def _require_range(column: str, values: NDArray[Any], stored: NDArray[np.bool_], least: float, most: float) -> None:
    wrong = np.flatnonzero(stored & ~((values >= least) & (values <= most)))
    if wrong.size:
        row = int(wrong[0])
        raise InvalidInput(f"alines/{column}[{row}]", values[row], f"{least:g} to {most:g}")


def _copy_resume_state(file: h5py.File, scan: _Scan, store: ScanFileWriter) -> None:
    """Copy the data needed to resume the scan: record of the last upload, if valid, and tuning reference."""
    queue, head, told = (untrusted.array(file, f"run/{name}") for name in ("queue", "upload", "reference"))
    if queue.shape != scan.stored.shape or head.shape != (schema.UPLOAD_FIELDS,) or told.shape != (4,):
        raise DamagedFile(f"{untrusted.name_of(file)}: run has datasets of the wrong shape")
    if queue.dtype != schema.UPLOAD or head.dtype != schema.UPLOAD or told.dtype != schema.REFERENCE:
        raise DamagedFile(f"{untrusted.name_of(file)}: run has datasets of the wrong kind")
    count, tag, fired, laser_shots, crc = head.tolist()
    rows = queue[:count]
    if 0 < count <= len(queue) and google_crc32c.value(rows.tobytes() + head[:-1].tobytes()) == crc:
        if rows.min() < 0 or rows.max() >= len(queue) or min(tag, fired, laser_shots) < 0:
            raise DamagedFile(f"{untrusted.name_of(file)}: run/queue names rows that are not there")
        store.record_upload(UploadRecord(rows.astype(np.int64), tag, fired, laser_shots))
    point = told[0]
    if not np.isfinite(told).all() or not 0 <= point < scan.plan.mask.count or point % 1:
        raise DamagedFile(f"{untrusted.name_of(file)}: run/reference is not a point and three finite numbers")
    store.set_reference(int(point), *told[1:].tolist())
