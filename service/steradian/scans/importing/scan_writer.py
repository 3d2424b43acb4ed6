"""Writer of an opened recording source into a new scan file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import Cancelled, InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.plans import ScanPlan, VisitOrder
from steradian.scans.file import schema
from steradian.scans.file.source_metadata import SOURCE
from steradian.scans.file.writer import ScanFileWriter, create_scan_file
from steradian.scans.importing.anomaly_detection import noticed
from steradian.scans.importing.import_remarks import remark
from steradian.scans.importing.source import RecordingSource

DEFAULT_PULSE_RATE, DUTY_CYCLE = 50.0, 0.5
"""Pulse rate of a plan made for a recording that states none, in Hz, and the share of a period its record may fill."""
EXCITATION = (200e-9, 3e-6)

MAX_VALUE = 1e15
"""Largest size of a sample times its scale: beyond any pressure, and squares still fit into float32."""

_PIECE = 1 << 20
"""Bytes that are stored at a time."""


@dataclass(frozen=True)
class ImportedAline:
    """Imported A-line for the scan file writer; unknown metadata are zero and the energy is nominal."""

    point: int
    samples: NDArray[np.int16] | NDArray[np.float32]
    scale: float
    shot: int
    energy: float = 1.0
    wavelength_m: float = 0.0
    fire_time_s: float = 0.0
    quality: int = 0
    averages: int = 1
    time_zero_offset_s: float = 0.0
    dc_v: float = 0.0
    gain_db: float = 0.0


def plan_of(source: RecordingSource) -> ScanPlan:
    """Create a scan plan that matches an imported recording.

    Raises
    ------
    InvalidInput
        When the recording is nothing a scan can be: no speed of sound, too short or too long records.
    """
    if source.sound_speed is None:
        states = f"{source.provenance['source']} states none"
        hint = "give an approximate value, and 'steradian sound-speed' finds the best one from the A-lines"
        raise InvalidInput("sound_speed", "missing", f"300 to 6000 (m/s) in a description; {states}; {hint}")
    mask = source.sensors.mask(source.format)
    if source.depth is not None:
        mask = mask.replace(depth=source.depth)
    record = source.table.samples * source.sampling_interval
    frames, excitation = source.table.frames, source.excitation
    known = bool(excitation) and len(set(excitation)) == len(excitation) and frames % len(excitation) == 0
    if not known or not all(EXCITATION[0] <= value <= EXCITATION[1] for value in excitation):
        if any(excitation):
            told = ", ".join(f"{value:g}" for value in excitation[:8])
            span = f"{EXCITATION[0]:g} to {EXCITATION[1]:g} m"
            remark(f"wavelengths of the light ({told} m) are not used: they must differ and lie in {span}")
        excitation = ()
    return ScanPlan.create(
        mask=mask,
        pulse_rate=min(DEFAULT_PULSE_RATE, DUTY_CYCLE / record),
        samples=source.table.samples,
        sampling_interval=source.sampling_interval,
        sound_speed=source.sound_speed,
        order=VisitOrder.GIVEN,
        frames=frames // max(1, len(excitation)),
        excitation=excitation,
        averages=source.averages,
    )


def write_scan(
    source: RecordingSource, path: Path, *, progress: Progress | None, cancelled: CancelCheck | None
) -> None:
    """Write a recording source into a new scan file, block by block.

    Integers of at most 16 bits stay what they are; everything else becomes float32.

    Raises
    ------
    InvalidInput
        When a sample is not finite, or the recording is nothing a scan can be.
    Cancelled
        When ``cancelled`` said so.
    """
    plan = plan_of(source)
    kind = schema.SAMPLES if np.can_cast(source.table.dtype, np.int16) else schema.EXACT_SAMPLES
    create_scan_file(
        path,
        plan,
        scanner=source.scanner,
        simulated=source.simulated,
        scanner_model=f"imported from {source.format}",
        sample_kind=kind,
        time_zero=source.time_zero,
    )
    total = source.table.points * source.table.frames
    rows = np.arange(total)
    with ScanFileWriter(path) as store:
        for start, block in noticed(source.table):
            if cancelled and cancelled():
                raise Cancelled(f"the import was stopped after {start} of {total} A-lines")
            for first, piece in split_block(start, block):
                store.append(_alines(first, piece, kind, source), rows)
            if progress:
                progress("A-lines", start + len(block), total)
        store.record_shot_count(total * source.averages)
    with h5py.File(path, "r+") as file:  # last: reading the A-lines may have added remarks
        file.attrs[SOURCE] = _origin(source)


def _origin(source: RecordingSource) -> str:
    said: dict[str, Any] = {
        "name": source.provenance.get("source", ""),
        "format": source.format,
        "notes": source.notes,
    }
    if source.details:
        said[source.format] = source.details
    return json.dumps(said)


def split_block(start: int, block: NDArray[Any]) -> Iterator[tuple[int, NDArray[Any]]]:
    """Yield parts of a block of A-lines with their first row numbers, to limit memory use."""
    step = max(1, _PIECE // (block.shape[1] * block.itemsize))
    for first in range(0, len(block), step):
        yield start + first, block[first : first + step]


def check_values(
    samples: NDArray[Any],
    scale: NDArray[np.float32] | float,
    rows: NDArray[np.int64],
    given: NDArray[Any] | None = None,
) -> None:
    """Raise :class:`InvalidInput` if a sample of a block (B, N_t) is not finite or too large.

    ``given`` is what the source had in its place.
    """
    if not len(samples):
        return
    with np.errstate(invalid="ignore"):
        largest = np.maximum(samples.max(axis=1).astype(np.float64), -samples.min(axis=1).astype(np.float64))
        wrong = np.flatnonzero(~(largest * scale <= MAX_VALUE))  # also where it is not a number
    if wrong.size:
        row = int(wrong[0])
        with np.errstate(invalid="ignore"):
            sizes = np.abs(samples[row].astype(np.float64))
        column = int(np.where(np.isfinite(sizes), sizes, np.inf).argmax())
        value = (samples if given is None else given)[row, column]
        raise InvalidInput(
            f"traces[{rows[row]}, {column}]", value, f"finite numbers, at most {MAX_VALUE:g} times scale"
        )


def _alines(start: int, block: NDArray[Any], kind: np.dtype[Any], source: RecordingSource) -> Iterator[ImportedAline]:
    with np.errstate(over="ignore", invalid="ignore"):  # what float32 cannot hold becomes infinite and is refused
        samples = block.astype(kind)
    check_values(samples, source.scale, np.arange(start, start + len(block)), block)
    each, points = source.time_zeros, source.table.points
    for index, row in enumerate(samples, start):
        zero = source.time_zero if each is None else float(each[index % points])
        about: dict[str, Any] = {"time_zero_offset_s": zero, "averages": source.averages}
        if source.energies is not None:
            about["energy"] = float(source.energies[index])
        yield ImportedAline(index, row, source.scale, index + 1, **about)
