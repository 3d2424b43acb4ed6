"""Reconstruction of a recording: writes volume, projections and report."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from steradian.core.atomic_files import atomic_write
from steradian.core.json_encoding import to_jsonable
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging import Acquisition, DirectMethod, Iterative, Volume, reconstruct
from steradian.imaging.engines.cuda import array_backend
from steradian.imaging.signal.bandwidth import resolve_upper_frequency
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.completeness import find_missing_points
from steradian.reconstructions.pipeline.motion import correct_motion, draw_motion
from steradian.reconstructions.pipeline.noise_gain_plot import draw_noise_gain
from steradian.reconstructions.pipeline.plan_cache import PlanCache
from steradian.reconstructions.pipeline.report import Report
from steradian.reconstructions.pipeline.report_notes import notes_on_depth, notes_on_weights
from steradian.reconstructions.pipeline.resolve import (
    ReconstructionSetup,
    effective_parameters,
    film_of,
    preprocess,
    request_field_names,
    resolve_setup,
    sound_speed_of,
    weights_of,
)
from steradian.reconstructions.pipeline.sensor_subsets import (
    NONE,
    SubsetOptions,
    standard_errors,
    suppressed_image,
    write_uncertainty,
)
from steradian.reconstructions.pipeline.size_limit import require_agreed
from steradian.reconstructions.shot_normalisation import ShotVariation, normalise_shots
from steradian.reconstructions.volumes.file import write_volume
from steradian.reconstructions.volumes.near_field import crop_depth, near_field_depth
from steradian.reconstructions.volumes.projections import project, project_below_depth
from steradian.scans.frames import FrameChoice
from steradian.scans.opening import FIRST, open_recording
from steradian.scans.recording import Recording

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

SHRINKAGE_NOTE = "the regulariser lowers amplitudes, by a third and more from few sensors; take those of thresholding"
METHODS_WITHOUT_WEIGHTS = ("interpolated", "iterative")
"""Methods that weights play no part in."""


def reconstruct_scan(
    scan: Path,
    output: Path,
    parameters: ReconstructionParameters | None = None,
    *,
    frame: int | FrameChoice = FIRST,
    motion: bool = False,
    subsets: SubsetOptions = NONE,
    plans: PlanCache | None = None,
    agreed: bool = True,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Report:
    """Reconstruct a recording and write ``volume.h5``, ``mip-{x,y,z}.png``, ``mip-depth.png`` and ``report.json``.

    Where attenuation was compensated, also ``noise-gain.png``, ``motion.png`` where motion was looked for, and
    ``uncertainty.h5`` where standard errors were asked for.

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
    motion
        Estimate the motion of the object within the scan, and undo it where it is significant.
    subsets
        Standard errors and suppression of artefacts.
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
    with report.measure_stage("read"):
        recording = open_recording(scan, frame)
    if not agreed:
        require_agreed(recording, chosen)
    return reconstruct_and_write(
        recording,
        output,
        chosen,
        report,
        motion=motion,
        subsets=subsets,
        plans=plans,
        progress=progress,
        cancelled=cancelled,
    )


def reconstruct_and_write(
    recording: Recording,
    output: Path,
    chosen: ReconstructionParameters,
    report: Report,
    *,
    motion: bool = False,
    subsets: SubsetOptions = NONE,
    plans: PlanCache | None = None,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Report:
    """Reconstruct a recording in memory and write the files of :func:`reconstruct_scan`; complete the report."""
    subsets.check(recording, chosen.method, motion=motion)
    report.parameters, report.missing = effective_parameters(recording, chosen), find_missing_points(recording)
    with report.measure_stage("even out"):
        recording, uneven = normalise_shots(recording, chosen.shots, progress=progress, cancelled=cancelled)
        if uneven != ShotVariation():  # else it was evened out before, and the report says how
            report.shots = uneven
    report.notes += notes_on_depth(recording, chosen)
    with report.measure_stage("reconstruct"):
        acquisition, setup = prepare(recording, chosen, progress=progress, cancelled=cancelled)
        report.note_band(acquisition, setup)
        altered = errors = None
        if motion:
            altered, report.motion = correct_motion(
                recording, acquisition, setup, progress=progress, cancelled=cancelled
            )
        elif subsets.suppress_artefacts:
            altered = suppressed_image(recording, acquisition, setup, cancelled=cancelled)
        volume = _image(acquisition, setup, plans, progress, cancelled) if altered is None else altered
        assert volume.info is not None  # noqa: S101 - it was reconstructed
        report.note_info(volume.info)
    if subsets.uncertainty:
        with report.measure_stage("standard errors"):
            errors = standard_errors(acquisition, setup, progress=progress, cancelled=cancelled)
    if report.device not in ("", "cpu"):
        array_backend.device().release()  # for the GPU's other users: this process may wait long for its next job
    report.axes = ", ".join(volume.names)
    report.shape, report.spacing_m = volume.values.shape, tuple(map(float, volume.spacing))
    report.origin_m, report.centre_m = tuple(map(float, volume.origin)), recording.centre
    report.sensors, report.planned = len(recording.positions), recording.planned
    report.sound_speed_m_s = sound_speed_of(recording, chosen)
    if chosen.method not in METHODS_WITHOUT_WEIGHTS:
        report.sensed_area_m2 = float(weights_of(recording, chosen).sum())
        report.notes += notes_on_weights(recording, report.sensed_area_m2)
    elif chosen.method == "iterative" and chosen.iterative.regularisation not in ("none", "thresholding"):
        report.notes.append(SHRINKAGE_NOTE)
    report.provenance = dict(recording.provenance)
    if subsets.suppress_artefacts:
        report.provenance["values"] = volume.info.notes[-1]
    report.notes += (*recording.notes, *chosen.film.notes(film_of(recording)))
    output.mkdir(parents=True, exist_ok=True)
    with report.measure_stage("project"):
        near = chosen.display.near_field
        report.near_field_m = near_field_depth(volume, recording.positions) if near is None else near
        shown, projections = project_below_depth(volume, report.near_field_m)
    with report.measure_stage("write"):
        write_volume(
            output / "volume.h5",
            volume,
            parameters=report.parameters,
            provenance=report.provenance,
            projections=projections,
            near_field=report.near_field_m,
            centre=recording.centre,
        )
        if errors is not None:
            report.uncertainty = write_uncertainty(
                output, volume, errors, recording, report.parameters, report.near_field_m
            )
    with report.measure_stage("draw"):
        from steradian.reconstructions.volumes.images import draw_depth_coded, draw_projection

        volume = crop_depth(volume, report.near_field_m)
        if chosen.display.changes_values:
            volume = chosen.display.apply(volume)
            shown = project(volume)
        report.scale_percentile = chosen.display.percentile
        for axis, image in shown.items():
            drawn = draw_projection(image, volume, axis, output / f"mip-{axis}.png", chosen.display)
            report.scale_ends[axis] = drawn.highest
        if volume.dimensions == 3:
            draw_depth_coded(volume, output / "mip-depth.png", chosen.display)
        if report.noise_gain:
            draw_noise_gain(report.noise_gain, output / "noise-gain.png")
        if report.motion is not None:
            draw_motion(report.motion, output / "motion.png")
    write_json(output / "report.json", report)
    return report


def reconstruct_in_memory(
    recording: Recording,
    parameters: ReconstructionParameters,
    *,
    plans: PlanCache | None = None,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Volume:
    """Reconstruct a recording without writing files; raises as :func:`reconstruct_scan`."""
    acquisition, setup = prepare(recording, parameters, progress=progress, cancelled=cancelled)
    return _image(acquisition, setup, plans, progress, cancelled)


def prepare(
    recording: Recording,
    parameters: ReconstructionParameters,
    *,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> tuple[Acquisition, ReconstructionSetup]:
    """Normalise and condition the A-lines of a recording, and resolve the reconstruction arguments.

    Raises
    ------
    InvalidInput
        When a parameter does not fit the recording.
    Cancelled
        If ``cancelled`` returned true.
    """
    recording, _ = normalise_shots(recording, parameters.shots, progress=progress, cancelled=cancelled)
    weighted = recording.sensitivity is not None and parameters.method != "interpolated"
    traces = preprocess(recording, parameters, divided=not weighted)
    setup = resolve_setup(recording, parameters)
    if weighted:
        setup = setup._replace(geometry=replace(setup.geometry, sensitivity=recording.sensitivity))
    if isinstance(setup.method, DirectMethod):
        highest = resolve_upper_frequency(setup.method.max_frequency, traces, recording.sampling_interval)
        setup = setup._replace(method=replace(setup.method, max_frequency=highest))
    return setup.geometry.acquisition(traces), setup


def _image(
    acquisition: Acquisition,
    setup: ReconstructionSetup,
    plans: PlanCache | None,
    progress: Progress | None,
    cancelled: CancelCheck | None,
) -> Volume:
    geometry, grid, method, compute = setup
    with request_field_names():
        if plans is None or isinstance(method, Iterative):
            return reconstruct(acquisition, grid, method, compute=compute, progress=progress, cancelled=cancelled)
        plan = plans.get(geometry, grid, method, compute)
        volume = plan.run(acquisition.traces, progress=progress, cancelled=cancelled)
        assert isinstance(volume, Volume)  # noqa: S101 - one set of traces
        return volume


def write_json(path: Path, figures: DataclassInstance) -> None:
    """Write a dataclass as a JSON file (atomic write)."""
    with atomic_write(path) as file:
        file.write_text(json.dumps(to_jsonable(figures), indent=2, allow_nan=False) + "\n", encoding="utf-8")
