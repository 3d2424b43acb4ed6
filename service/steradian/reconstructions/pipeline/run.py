"""Reconstruction pipeline: recording → volume, projections and report."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from steradian.core.atomic_files import draft
from steradian.core.json_encoding import plain
from steradian.core.progress import IsCancelled, Progress
from steradian.imaging import ReconstructionPlan, Volume
from steradian.imaging._reconstruct import image_by
from steradian.imaging.engines.cuda import backend
from steradian.imaging.signal.bandwidth import share_above, upper_limit
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.completeness import Missing, missing_points
from steradian.reconstructions.pipeline.diagnostics import Band, Fit
from steradian.reconstructions.pipeline.plan_cache import KeptPlans
from steradian.reconstructions.pipeline.report_notes import notes_on_depth, notes_on_weights
from steradian.reconstructions.pipeline.resolve import (
    conditioned,
    film_of,
    plan_parameters,
    sound_speed_of,
    used,
    weights_of,
)
from steradian.reconstructions.pipeline.size_limit import require_agreed
from steradian.reconstructions.shots import Unevenness, even_out
from steradian.reconstructions.volumes.file import write_volume
from steradian.reconstructions.volumes.near_field import from_depth, near_field
from steradian.reconstructions.volumes.projections import project, project_from
from steradian.scans.frames import FrameChoice
from steradian.scans.opening import FIRST, open_recording
from steradian.scans.recording import Recording

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from steradian.imaging.iterative.solve import IterativeResult

LOWERED = "the regulariser lowers amplitudes, by a third and more from few sensors; take those of thresholding"
WITHOUT_WEIGHTS = ("interpolated", "iterative")
"""Methods that weights play no part in."""


@dataclass
class Report:
    """Figures of a finished reconstruction, as written to ``report.json``."""

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
    """What to know of the image before it is trusted."""
    parameters: dict[str, object] = field(default_factory=dict)
    provenance: dict[str, str] = field(default_factory=dict)
    missing: Missing | None = None
    """What a partly measured scan lacks."""
    fit: Fit | None = None
    """How the method iterative found the image."""
    band: Band | None = None
    """Up to which frequency A-lines were used, where that was asked for."""
    shots: Unevenness = field(default_factory=Unevenness)
    """What A-lines differed in, and how many were left out."""
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

    def note_fit(self, found: IterativeResult) -> None:
        """Note how an image was found."""
        self.note_device(found.device, found.notes)
        misfits = tuple(round(value, 6) for value in found.residuals)
        self.fit = Fit(found.iterations, found.stopped, found.products, misfits[-1], misfits)

    def note_device(self, name: str, notes: Sequence[str]) -> None:
        """Record the device that computed, and the reason if it is not the requested one."""
        self.device = name
        self.notes += notes

    def note_band(self, band: Band) -> None:
        """Note which frequencies were used; the parameters say it in Hz."""
        self.band = band
        self.parameters["highest_frequency"] = band.highest_frequency_hz

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Note the wall time of a stage."""
        start = time.perf_counter()
        yield
        self.seconds[stage] = round(time.perf_counter() - start, 3)


def reconstruct_scan(
    scan: Path,
    output: Path,
    parameters: ReconstructionParameters | None = None,
    *,
    frame: int | FrameChoice = FIRST,
    plans: KeptPlans | None = None,
    agreed: bool = True,
    progress: Progress | None = None,
    cancelled: IsCancelled | None = None,
) -> Report:
    """Reconstruct a recording and write ``volume.h5``, ``mip-{x,y,z}.png``, ``mip-depth.png`` and ``report.json``.

    Parameters
    ----------
    scan
        A scan file or another known recording (:func:`steradian.scans.opening.open_recording`).
    output
        Folder for the results; each appears under its name only when it is whole.
    parameters
        What to choose; the defaults fit a scan.
    frame
        Which frame, or which frames' mean, of a scan that has several; by default the first, with a note.
    plans
        Where plans are looked for and kept, if many recordings of one geometry are reconstructed.
    agreed
        Whether a volume file above 1 GB is made.
    progress, cancelled
        Reported and asked between pieces of work.

    Raises
    ------
    NotFound, DamagedFile
        When the recording cannot be read.
    InvalidInput
        When a parameter does not fit the recording; :class:`~steradian.reconstructions.pipeline.size_limit.LargeVolume`
        when the volume is large and not agreed to.
    Cancelled
        When ``cancelled`` said so.
    """
    chosen = parameters or ReconstructionParameters()
    report = Report()
    with report.timed("read"):
        recording = open_recording(scan, frame)
    if not agreed:
        require_agreed(recording, chosen)
    return write_reconstruction(recording, output, chosen, report, plans=plans, progress=progress, cancelled=cancelled)


def write_reconstruction(
    recording: Recording,
    output: Path,
    chosen: ReconstructionParameters,
    report: Report,
    *,
    plans: KeptPlans | None = None,
    progress: Progress | None = None,
    cancelled: IsCancelled | None = None,
) -> Report:
    """Do the same as :func:`reconstruct_scan` with a recording that has been read; the report is completed."""
    report.parameters, report.missing = used(recording, chosen), missing_points(recording)
    with report.timed("even out"):
        recording, uneven = even_out(recording, chosen.shots, progress=progress, cancelled=cancelled)
        if uneven != Unevenness():  # else it was evened out before, and the report says how
            report.shots = uneven
    report.notes += notes_on_depth(recording, chosen)
    with report.timed("reconstruct"):
        volume = reconstruct_recording(
            recording,
            chosen,
            plans=plans,
            on_fit=report.note_fit,
            on_band=report.note_band,
            on_device=report.note_device,
            progress=progress,
            cancelled=cancelled,
        )
    if report.device not in ("", "cpu"):
        backend.device().release()  # for the GPU's other users: this process may wait long for its next job
    report.axes = ", ".join(volume.names)
    report.shape, report.spacing_m = volume.values.shape, tuple(map(float, volume.spacing))
    report.origin_m, report.centre_m = tuple(map(float, volume.origin)), recording.centre
    report.sensors, report.planned = len(recording.positions), recording.planned
    report.sound_speed_m_s = sound_speed_of(recording, chosen)
    if chosen.method not in WITHOUT_WEIGHTS:
        report.sensed_area_m2 = float(weights_of(recording, chosen).sum())
        report.notes += notes_on_weights(recording, report.sensed_area_m2)
    elif chosen.method == "iterative" and chosen.iterative.regularisation not in ("none", "thresholding"):
        report.notes.append(LOWERED)
    report.provenance = recording.provenance
    report.notes += (*recording.notes, *chosen.film.notes(film_of(recording)))
    output.mkdir(parents=True, exist_ok=True)
    with report.timed("project"):
        near = chosen.display.near_field
        report.near_field_m = near_field(volume, recording.positions) if near is None else near
        shown, projections = project_from(volume, report.near_field_m)
    with report.timed("write"):
        write_volume(
            output / "volume.h5",
            volume,
            parameters=report.parameters,
            provenance=recording.provenance,
            projections=projections,
            near_field=report.near_field_m,
            centre=recording.centre,
        )
    with report.timed("draw"):
        from steradian.reconstructions.volumes.images import draw_depth_coded, draw_projection

        volume = from_depth(volume, report.near_field_m)
        if chosen.display.changes_values:
            volume = chosen.display.apply(volume)
            shown = project(volume)
        report.scale_percentile = chosen.display.percentile
        for axis, image in shown.items():
            drawn = draw_projection(image, volume, axis, output / f"mip-{axis}.png", chosen.display)
            report.scale_ends[axis] = drawn.highest
        if volume.dimensions == 3:
            draw_depth_coded(volume, output / "mip-depth.png", chosen.display)
    write_json(output / "report.json", report)
    return report


def reconstruct_recording(
    recording: Recording,
    parameters: ReconstructionParameters,
    *,
    plans: KeptPlans | None = None,
    on_fit: Callable[[IterativeResult], None] | None = None,
    on_band: Callable[[Band], None] | None = None,
    on_device: Callable[[str, Sequence[str]], None] | None = None,
    progress: Progress | None = None,
    cancelled: IsCancelled | None = None,
) -> Volume:
    """Reconstruct a recording in memory; see :func:`reconstruct_scan` and :func:`steradian.imaging._reconstruct`."""
    recording, _ = even_out(recording, parameters.shots, progress=progress, cancelled=cancelled)
    traces = conditioned(recording, parameters)
    highest = upper_limit(parameters.highest_frequency, traces, recording.sampling_interval)
    if highest is not None and on_band is not None:
        on_band(Band(highest, share_above(highest, traces, recording.sampling_interval)))
    chosen = replace(plan_parameters(recording, parameters), highest_frequency=highest)
    if chosen.method == "iterative":
        return image_by(chosen, traces, recording.positions, on_fit=on_fit, progress=progress, cancelled=cancelled)
    if plans is None or chosen.correction is not None:
        plan = ReconstructionPlan.of(recording.positions, traces.shape[1], chosen)
    else:
        plan = plans.get(recording.positions, traces.shape[1], chosen)
    volume = plan.run(traces, progress=progress, cancelled=cancelled)
    assert isinstance(volume, Volume)  # noqa: S101 - one set of traces
    if on_device is not None:
        on_device(plan.chosen.device, plan.chosen.notes)
    return volume


def write_json(path: Path, figures: DataclassInstance) -> None:
    """Write a dataclass as JSON under a temporary name and rename it."""
    with draft(path) as file:
        file.write_text(json.dumps(plain(figures), indent=2, allow_nan=False) + "\n", encoding="utf-8")
