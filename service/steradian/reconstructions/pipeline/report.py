"""Report of a finished reconstruction."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from steradian.imaging import Acquisition, Iterative, ReconstructionInfo
from steradian.imaging.signal.bandwidth import power_fraction_above
from steradian.reconstructions.pipeline.completeness import IncompleteCoverage
from steradian.reconstructions.pipeline.diagnostics import BandLimit, FitDiagnostics
from steradian.reconstructions.pipeline.motion import MotionReport
from steradian.reconstructions.pipeline.resolve import ReconstructionSetup
from steradian.reconstructions.pipeline.sensor_subsets import UncertaintyReport
from steradian.reconstructions.shot_normalisation import ShotVariation


@dataclass
class Report:
    """Report of a finished reconstruction, as written to ``report.json``."""

    shape: tuple[int, ...] = ()
    spacing_m: tuple[float, ...] = ()
    origin_m: tuple[float, ...] = ()
    """Centre of the first voxel along each axis."""
    centre_m: tuple[float, ...] = ()
    """Place of x = y = 0 in the frame of the file that the sensors' positions came from; () where it is ours."""
    axes: str = "x, y, z"
    sensors: int = 0
    planned: int = 0
    sound_speed_m_s: float = 0.0
    sensed_area_m2: float | None = None
    """What the sensors stand for together, the sum of their weights; for a line a length in m. ``None`` for methods
    that weights play no part in."""
    notes: list[str] = field(default_factory=list)
    """Notes on the image's reliability."""
    parameters: dict[str, object] = field(default_factory=dict)
    provenance: dict[str, str] = field(default_factory=dict)
    missing: IncompleteCoverage | None = None
    """Missing parts of a partly measured scan."""
    fit: FitDiagnostics | None = None
    """How the method iterative found the image."""
    noise_gain: tuple[tuple[float, float], ...] = ()
    """Depths in m and the amplification of the A-lines' noise there by the compensation of attenuation."""
    band: BandLimit | None = None
    """Up to which frequency A-lines were used, where that was asked for."""
    shots: ShotVariation = field(default_factory=ShotVariation)
    """What A-lines differed in, and how many were left out."""
    motion: MotionReport | None = None
    """Motion found within the scan, where it was asked for."""
    uncertainty: UncertaintyReport | None = None
    """Standard errors, where they were asked for."""
    device: str = ""
    """What computed: "cpu", or the GPU's name."""
    near_field_m: float = 0.0
    """Depth in m from which on the pictures show the image: nearer, the sensors' own noise outshines it."""
    scale_percentile: float = 0.0
    scale_ends: dict[str, float] = field(default_factory=dict)
    """Value at the end of the scale of each picture; by ``scale_percentile`` of its projection's values."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Wall time of each stage."""

    def __repr__(self) -> str:
        voxels = " × ".join(map(str, self.shape))
        sensors = f"{self.sensors:,} of {self.planned:,} sensors at {self.sound_speed_m_s:g} m/s"
        return f"<Report: {voxels} voxels from {sensors}, {sum(self.seconds.values()):.3g} s>"

    def note_info(self, info: ReconstructionInfo) -> None:
        """Record the device used, notes of the library, and the convergence of an iterative method."""
        self.device = info.device
        self.notes += info.notes
        self.noise_gain = info.noise_gain
        if info.iterations:
            misfits = tuple(round(value, 6) for value in info.residuals)
            self.fit = FitDiagnostics(info.iterations, info.stop_reason, info.products, misfits[-1], misfits)

    def note_band(self, acquisition: Acquisition, setup: ReconstructionSetup) -> None:
        """Record the upper frequency limit in Hz, and the share of the A-lines' power above the limit."""
        if isinstance(setup.method, Iterative) or setup.method.max_frequency is None:
            return
        highest = float(setup.method.max_frequency)
        self.band = BandLimit(highest, power_fraction_above(highest, np.asarray(acquisition.traces), acquisition.dt))
        self.parameters["highest_frequency"] = highest

    @contextmanager
    def measure_stage(self, stage: str) -> Iterator[None]:
        """Context manager that records the wall time of a stage."""
        start = time.perf_counter()
        yield
        self.seconds[stage] = round(time.perf_counter() - start, 3)
