"""Preview of a recording without an import: metadata, missing fields, sample A-lines."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from steradian.core.quantity_ranges import SOUND_SPEED
from steradian.plans import ScanPlan
from steradian.scans.importing import scan_files
from steradian.scans.importing.aline_blocks import TraceBlocks
from steradian.scans.importing.detect import is_scan_file, open_recording_source
from steradian.scans.importing.source import MissingField, RecordingSource, collecting_missing_fields

TRACES, POSITIONS, SAMPLES = 5, 4000, 4096
"""At most so many A-lines and positions are shown, and samples of each A-line."""


@dataclass(frozen=True)
class RecordingSummary:
    """Preview of a recording; ``None`` for fields that the recording does not state.

    Parameters
    ----------
    format
        Kind of the file.
    points, frames, samples, dtype
        Shape and kind of its A-lines.
    sampling_interval, time_zero, sound_speed, aperture, depth
        Seconds, seconds, m/s, metres, metres.
    positions
        (P, 1 or 2) metres, at most ``POSITIONS``, evenly picked over the aperture.
    rows, traces
        Some of the first A-lines and which they are; their first samples.
    missing
        What must be said before it can be imported.
    notes
        What was decided or assumed.
    """

    format: str
    points: int
    frames: int
    samples: int
    dtype: str
    sampling_interval: float | None
    time_zero: float
    sound_speed: float | None
    aperture: float | None
    depth: float | None
    positions: list[list[float]] | None
    rows: list[int]
    traces: list[list[float]]
    missing: list[MissingField]
    notes: list[str] = field(default_factory=list)


def inspect_recording(source: Path, description: Path | None = None, folder: Path | None = None) -> RecordingSummary:
    """Read the metadata of a recording as an import would interpret it, without importing.

    Parameters
    ----------
    source, description, folder
        As in :func:`~steradian.scans.importing.detect.open_recording_source`.

    Raises
    ------
    NotFound, DamagedFile, InvalidInput
        As an import, but not for what is missing.
    """
    if is_scan_file(source):
        with scan_files.open_scan(source) as (plan, table, time_zero):
            return _own(plan, table, time_zero)
    with collecting_missing_fields() as lacks, open_recording_source(source, description, folder) as opened:
        return _look(opened, lacks)


def _look(source: RecordingSource, lacks: list[MissingField]) -> RecordingSummary:
    unknown = {lack.field for lack in lacks}
    if source.sound_speed is None:
        lacks.append(MissingField("sound_speed", f"{SOUND_SPEED}; the file states none"))
    placed = "positions" not in unknown
    rows, traces = _some(source.table)
    return RecordingSummary(
        format=source.format,
        points=source.table.points,
        frames=source.table.frames,
        samples=source.table.samples,
        dtype=source.table.dtype.name,
        sampling_interval=None if "sampling_interval" in unknown else source.sampling_interval,
        time_zero=source.time_zero,
        sound_speed=source.sound_speed,
        aperture=source.sensors.aperture if placed else None,
        depth=source.depth,
        positions=_spread(source.sensors.positions) if placed else None,
        rows=rows,
        traces=traces,
        missing=lacks,
        notes=list(source.notes),
    )


def _own(plan: ScanPlan, table: TraceBlocks, time_zero: float) -> RecordingSummary:
    rows, traces = _some(table)
    return RecordingSummary(
        format=scan_files.FORMAT,
        points=plan.mask.count,
        frames=plan.frames,
        samples=plan.samples,
        dtype=table.dtype.name,
        sampling_interval=plan.sampling_interval,
        time_zero=time_zero,
        sound_speed=plan.sound_speed,
        aperture=plan.mask.aperture,
        depth=plan.mask.depth,
        positions=_spread(plan.mask.film_positions),
        rows=rows,
        traces=traces,
        missing=[],
    )


def _some(table: TraceBlocks) -> tuple[list[int], list[list[float]]]:
    """Return the numbers and samples of a few A-lines from the first block."""
    start, block = next(iter(table.blocks()))
    rows = np.unique(np.linspace(0, len(block) - 1, TRACES).round().astype(int))
    return (start + rows).tolist(), np.nan_to_num(block[rows, :SAMPLES].astype(np.float64)).tolist()


def _spread(positions: NDArray[np.float64]) -> list[list[float]]:
    """Return at most ``POSITIONS`` of the positions: of a lattice every k-th along each axis, else every k-th."""
    found: list[list[float]]
    if len(positions) <= POSITIONS or positions.shape[1] == 1:
        found = positions[:: -(-len(positions) // POSITIONS)].tolist()
        return found
    lines = [np.unique(axis.round(9), return_inverse=True) for axis in positions.T]
    if np.prod([len(values) for values, _ in lines]) <= 2 * len(positions):  # picked one after the other: stripes
        step = int(np.ceil(np.sqrt(len(positions) / POSITIONS)))
        found = positions[np.all([place % step == 0 for _, place in lines], axis=0)].tolist()
    else:
        found = positions[:: -(-len(positions) // POSITIONS)].tolist()
    return found
