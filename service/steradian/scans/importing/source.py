"""Recording source: an opened file with A-lines in blocks and metadata in SI units."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import SAMPLING_INTERVAL, TIME_ZERO
from steradian.scans.importing.aline_blocks import TraceBlocks
from steradian.scans.importing.anomaly_detection import noticed
from steradian.scans.importing.description import Description, grid_points
from steradian.scans.importing.geometry import SensorPlacement, fit_sensor_plane
from steradian.scans.importing.import_remarks import remark, remarks
from steradian.scans.importing.pulse_energies import relative_energies
from steradian.scans.importing.units import require_extent, unit_hint, unit_of_times
from steradian.scans.recording import Recording, ShotMetadata

_T = TypeVar("_T")
UNITLESS = ("npz", "matlab")  # formats whose numbers may be in any unit


@dataclass(frozen=True)
class MissingField:
    """Metadata field that neither file nor description states, with its allowed values."""

    field: str
    allowed: str


_noted: ContextVar[list[MissingField] | None] = ContextVar("noted", default=None)


@contextmanager
def collecting_missing_fields() -> Iterator[list[MissingField]]:
    """Context manager in which :func:`make_source` records missing fields and continues with placeholder values."""
    lacks: list[MissingField] = []
    token = _noted.set(lacks)
    try:
        yield lacks
    finally:
        _noted.reset(token)


def _missing(field: str, allowed: str, instead: _T) -> _T:
    """Raise InvalidInput for a missing field; inside :func:`collecting_missing_fields`, return a placeholder."""
    lacks = _noted.get()
    if lacks is None:
        raise InvalidInput(field, "missing", allowed)
    lacks.append(MissingField(field, allowed))
    return instead


@dataclass(frozen=True)
class Metadata:
    """Metadata stated by a file, in SI units; ``None`` for fields that the file does not state."""

    points: NDArray[np.floating[Any]] | None = None
    """(M, 1 to 3) positions."""
    bounds: NDArray[np.float64] | None = None
    """(A, 2) limits of the aperture."""
    weights: NDArray[np.float64] | None = None
    """(M,) areas in m², in m on a line; relative ones where their sum cannot be an area."""
    aperture: float | None = None
    sampling_interval: float | None = None
    sound_speed: float | None = None
    time_zero: float | NDArray[np.float64] = 0.0
    """Of all A-lines, or (M,) of each sensor."""
    depth: float | None = None
    averages: int = 1
    energies: NDArray[np.float64] | None = None
    """Of the pulses, in any unit: of each A-line (frames, M), of each sensor (M,) or of each frame."""
    details: dict[str, Any] = field(default_factory=dict)
    """What the scan file's record of its source keeps beside all this."""
    excitation: tuple[float, ...] = ()
    """Wavelengths of the light in m; as many frames of each as come out even."""
    scanner: str = ""
    simulated: bool = False
    placing: str = ""
    """Arrays of the file that would place its sensors, for the message where positions are missing."""


@dataclass(frozen=True)
class RecordingSource:
    """Opened file of A-lines that are read in blocks, with complete metadata.

    Parameters
    ----------
    format
        What kind of file it came from.
    table
        The A-lines.
    sensors
        Where they were sensed; row m of the table at position m.
    sampling_interval, sound_speed, time_zero, depth
        Seconds, m/s (``None``: not known), seconds, metres.
    scale
        Pressure per unit of the table.
    excitation
        Wavelengths of the light in m, empty where not known; the frames of one follow each other.
    scanner, simulated
        Provenance.
    time_zeros
        (M,) seconds of each sensor where they differ; ``time_zero`` is then the earliest.
    energies
        (frames·M,) pulse energies over their mean; ``None``: not known.
    averages, details
        Pulses averaged into an A-line; what the scan file's record of its source keeps.
    notes
        What was decided or assumed, also while the A-lines are read.
    """

    format: str
    table: TraceBlocks
    sensors: SensorPlacement
    sampling_interval: float
    sound_speed: float | None
    time_zero: float
    depth: float | None
    scale: float
    excitation: tuple[float, ...]
    scanner: str
    simulated: bool
    provenance: dict[str, str] = field(default_factory=dict)
    time_zeros: NDArray[np.float64] | None = None
    energies: NDArray[np.float64] | None = None
    averages: int = 1
    details: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def recording(self) -> Recording:
        """Read the first frame into memory as a recording."""
        sensors, mask = self.sensors, self.sensors.mask(self.format)
        blocks = [
            rows.astype(rows.dtype.newbyteorder("="))
            for start, rows in noticed(self.table)
            if start < self.table.points
        ]
        return Recording(
            traces=np.concatenate(blocks),
            scale=self.scale,
            positions=sensors.positions,
            weights=mask.weights,
            outline=mask.outline,
            sampling_interval=self.sampling_interval,
            sound_speed=self.sound_speed,
            aperture=sensors.aperture,
            time_zero=self.time_zero,
            grid=sensors.grid,
            centre=sensors.centre,
            depth=self.depth,
            planned=self.table.points,
            provenance=self.provenance,
            notes=tuple(self.notes),
            shots=self._shots(),
        )

    def _shots(self) -> ShotMetadata | None:
        """Return the per-A-line metadata of the first frame; ``None`` if all A-lines are alike."""
        if self.time_zeros is None and self.energies is None:
            return None
        points = self.table.points
        shots = ShotMetadata.default(np.full(points, self.time_zero) if self.time_zeros is None else self.time_zeros)
        return shots if self.energies is None else replace(shots, energy=self.energies[:points])


def make_source(
    kind: str,
    table: TraceBlocks,
    stated: Metadata,
    said: Description,
    name: str,
    lateral: tuple[int, ...] | None = None,
) -> RecordingSource:
    """Create a recording source from the metadata of a file and its description, which takes precedence.

    Parameters
    ----------
    kind, table, stated, said, name, lateral
        The format, its A-lines, what the file and the description say, the file's name, and the numbers of sensors
        along x and y where the file's array has such axes.

    Raises
    ------
    InvalidInput
        When something needed is said by neither, or the positions do not match the A-lines.
    """
    if kind in UNITLESS:
        stated = _in_units(stated, said)
    points = _described_points(said, stated, lateral, table.points)
    if len(points) != table.points:
        allowed = f"{table.points}, one for each A-line of {table.samples} samples"
        if len(points) == table.samples:
            allowed += '; if time comes first, a description says "axes": "time, point", else "point, time"'
        raise InvalidInput("positions", f"{len(points)} positions", allowed)
    interval = said.seconds(said.sampling_interval) or stated.sampling_interval
    if interval is None:
        interval = _missing("sampling_interval", "> 0 (s), which the file does not state", 1e-8)
    if interval not in SAMPLING_INTERVAL:
        given = f"{said.sampling_interval:g} {said.times}" if said.sampling_interval else f"{interval:g} s"
        hint = unit_hint(
            said.sampling_interval is not None, "times", said.times if said.sampling_interval else unit_of_times(said)
        )
        raise InvalidInput("sampling_interval", given, f"{SAMPLING_INTERVAL}; {hint}")
    require_extent(points, said)
    weights = said.weights if said.weights is not None else stated.weights
    aperture = said.metres(said.aperture) or stated.aperture
    area = None if said.weights is not None or weights is None else float(weights.sum())
    sensors = fit_sensor_plane(points, aperture=aperture, bounds=stated.bounds, weights=weights, sensed_area=area)
    delay = said.seconds(said.time_zero)
    if said.time_zero_samples is not None:
        delay = (delay or 0.0) + said.time_zero_samples * interval
    earliest, each = _time_zeros(stated.time_zero if delay is None else delay, said, table.points)
    return RecordingSource(
        format=kind,
        table=table,
        sensors=sensors,
        sampling_interval=interval,
        sound_speed=said.sound_speed or stated.sound_speed,
        time_zero=earliest,
        time_zeros=each,
        energies=relative_energies(stated.energies, table.frames, table.points),
        depth=said.metres(said.depth) or stated.depth,
        scale=said.scale,
        excitation=stated.excitation,
        scanner=said.scanner or stated.scanner,
        simulated=stated.simulated if said.simulated is None else said.simulated,
        provenance={"source": name},
        averages=stated.averages,
        details=stated.details,
        notes=remarks(),
    )


def _in_units(stated: Metadata, said: Description) -> Metadata:
    """Convert the lengths and times of a file to SI units, if the description states their unit."""
    length = 1.0 if said.has_lengths else said.length_unit
    time = 1.0 if said.has_times else said.time_unit
    for noun, unit, factor in (("lengths", said.lengths, length), ("times", said.times, time)):
        if factor != 1:
            remark(f"{noun} in the file were taken in {unit}")

    def scaled(value: Any, unit: float) -> Any:
        return None if value is None else value * unit

    return replace(
        stated,
        points=scaled(stated.points, length),
        aperture=scaled(stated.aperture, length),
        depth=scaled(stated.depth, length),
        sampling_interval=scaled(stated.sampling_interval, time),
        time_zero=stated.time_zero * time,
    )


def _time_zeros(
    stated: float | NDArray[np.float64], said: Description, points: int
) -> tuple[float, NDArray[np.float64] | None]:
    """Return the earliest time zero, and an array of each sensor's time zero if these differ."""
    values = np.asarray(stated, np.float64)
    if values.ndim and max(values.shape) == values.size:  # a row or a column
        values = values.reshape(-1)
    if values.shape not in ((), (points,)):
        allowed = f"one number, or one for each of the {points} sensors, in a file or one in a description"
        raise InvalidInput("time_zero", f"an array of {values.size} numbers", allowed)
    wrong = [value for value in values.reshape(-1).tolist() if value not in TIME_ZERO]
    if wrong:
        given = f"{wrong[0]:g} s" if said.time_zero is None else f"{said.time_zero:g} {said.times}"
        hint = unit_hint(said.time_zero is not None, "times", said.times)
        raise InvalidInput("time_zero", given, f"{TIME_ZERO}; {hint}")
    return float(values.min()), values if values.ndim else None


def _described_points(
    said: Description, stated: Metadata, lateral: tuple[int, ...] | None, count: int
) -> NDArray[np.floating[Any]]:
    if said.grid is not None:
        counts, interval = said.grid.count or lateral, said.grid.interval
        if counts is None or len(counts) != len(interval):
            raise InvalidInput("grid.count", counts or "missing", f"{len(interval)} numbers, one an interval")
        return grid_points(counts, tuple(step * said.length_unit for step in interval))
    if said.positions is not None and not isinstance(said.positions, str):
        return np.asarray(said.positions, np.float64).reshape(len(said.positions), -1) * said.length_unit
    if stated.points is None:
        allowed = "positions or a grid (interval, count) of the sensors, in a description (JSON)"
        allowed = f"{stated.placing}; or {allowed}" if stated.placing else allowed
        return _missing("positions", allowed, np.linspace(-0.01, 0.01, count)[:, None])
    return stated.points
