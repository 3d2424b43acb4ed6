"""Report of a finished series."""

from __future__ import annotations

from dataclasses import dataclass, field

from steradian.reconstructions.pipeline.motion import MotionReport
from steradian.reconstructions.series.alignment import ShiftReport
from steradian.reconstructions.shot_normalisation import ShotVariation


@dataclass
class FrameReport:
    """Report of one volume of a series."""

    numbers: tuple[int, ...]
    excitation_m: float
    time_s: float | None
    sensors: int
    planned: int
    shots: ShotVariation
    notes: tuple[str, ...] = ()
    iterations: int | None = None
    misfit: float | None = None
    maximum: float = 0.0
    shift: ShiftReport | None = None
    motion: MotionReport | None = None


@dataclass
class SeriesReport:
    """Report of a finished series, as written to ``report.json``."""

    shape: tuple[int, ...] = ()
    spacing_m: tuple[float, ...] = ()
    origin_m: tuple[float, ...] = ()
    axes: str = "x, y, z"
    sound_speed_m_s: float = 0.0
    centre_m: tuple[float, ...] = ()
    sensed_area_m2: float | None = None
    near_field_m: float = 0.0
    device: str = ""
    notes: list[str] = field(default_factory=list)
    parameters: dict[str, object] = field(default_factory=dict)
    provenance: dict[str, str] = field(default_factory=dict)
    frames: list[FrameReport] = field(default_factory=list)
    scale_percentile: float = 0.0
    scale_ends: dict[str, float] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)
