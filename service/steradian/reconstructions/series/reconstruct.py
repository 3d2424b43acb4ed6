"""Reconstruction of a scan with several frames into one series of volumes."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from steradian.core.progress import CancelCheck, Progress
from steradian.imaging import DirectMethod, Volume, reconstruct
from steradian.imaging.signal.bandwidth import resolve_upper_frequency
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.motion import MotionReport, correct_motion, draw_motion
from steradian.reconstructions.pipeline.plan_cache import PlanCache
from steradian.reconstructions.pipeline.report_notes import notes_on_depth, notes_on_weights
from steradian.reconstructions.pipeline.resolve import (
    ReconstructionSetup,
    effective_parameters,
    film_of,
    preprocess,
    request_field_names,
    sound_speed_of,
    weights_of,
)
from steradian.reconstructions.pipeline.run import METHODS_WITHOUT_WEIGHTS, SHRINKAGE_NOTE, prepare, write_json
from steradian.reconstructions.pipeline.size_limit import require_agreed
from steradian.reconstructions.series.alignment import Aligner, draw_shifts
from steradian.reconstructions.series.contact_sheet import draw_contact_sheet
from steradian.reconstructions.series.file import SeriesWriter
from steradian.reconstructions.series.frames import SeriesFrame, measured, series_choices
from steradian.reconstructions.series.report import FrameReport, SeriesReport
from steradian.reconstructions.series.series import Series
from steradian.reconstructions.shot_normalisation import ShotVariation, normalise_shots
from steradian.reconstructions.volumes.images import Axis
from steradian.reconstructions.volumes.near_field import crop_depth, near_field_depth
from steradian.reconstructions.volumes.projections import project, project_below_depth
from steradian.scans.file.read import list_frames
from steradian.scans.frames import FrameChoice
from steradian.scans.opening import open_recording
from steradian.scans.recording import Recording

Choices = Sequence[tuple[SeriesFrame, int | FrameChoice]]


def reconstruct_series(
    scan: Path,
    output: Path,
    parameters: ReconstructionParameters | None = None,
    *,
    wavelength: float | None = None,
    average: bool = False,
    align: bool = False,
    motion: bool = False,
    plans: PlanCache | None = None,
    agreed: bool = True,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> SeriesReport:
    """Reconstruct all frames of a scan file and write ``series.h5``, a contact sheet and ``report.json``.

    The contact sheet is ``mip-z.png``, of images from a line of sensors ``mip-y.png``.

    The frames share the plan, where they have the same sensors, and the upper end of the band, that of the first one.
    The method iterative starts each volume from the one before with the same wavelength, else from the one before.

    Parameters
    ----------
    scan
        A scan file.
    output
        Folder for the results; each appears under its name only when it is whole.
    parameters
        As of :func:`steradian.reconstructions.pipeline.run.reconstruct_scan`.
    wavelength
        Excitation wavelength in m to which the series is limited; None: all.
    average
        The mean of the frames at each wavelength, instead of each frame.
    align
        Undo significant shifts of the object from its place in the first volume; drawn in ``shifts.png``.
    motion
        Estimate and undo the motion within each frame; drawn in ``motion-0.png`` and so on.
    plans
        Where plans are looked for and kept; None: one is kept during the series.
    agreed
        Whether a file above 1 GB is made.
    progress, cancelled
        Reported and asked between pieces of work.

    Raises
    ------
    NotFound, DamagedFile
        When the scan cannot be read.
    InvalidInput
        When a parameter does not fit the scan, no frame has the wavelength, or the file is large and not agreed to.
    Cancelled
        When ``cancelled`` said so.
    """
    began = time.perf_counter()
    chosen = parameters or ReconstructionParameters()
    frames = list_frames(scan)
    choices = series_choices(measured(frames), wavelength=wavelength, average=average)
    report = SeriesReport()
    if missing := len(frames) - len(measured(frames)):
        report.notes.append(f"the last {missing} of {len(frames)} frames have no A-lines: the scan ended before")
    first, _ = normalise_shots(open_recording(scan, choices[0][1]), chosen.shots)
    if not agreed:
        require_agreed(first, chosen, count=len(choices))
    report.parameters, report.provenance = effective_parameters(first, chosen), first.provenance
    report.sound_speed_m_s, report.centre_m = sound_speed_of(first, chosen), first.centre
    report.scale_percentile = chosen.display.percentile
    _add_notes(report, first, chosen)
    output.mkdir(parents=True, exist_ok=True)
    about: dict[str, Any] = {"parameters": _with_speed(report), "provenance": report.provenance}
    pictures = []
    aligner, motions = Aligner() if align else None, list[MotionReport]()
    with SeriesWriter(output / "series.h5", centre=first.centre, **about) as writer:
        for frame, volume, recording, shots in _volumes(
            scan, choices, chosen, plans, progress, cancelled, motions if motion else None
        ):
            shift = None
            if aligner is not None:
                volume, shift = aligner.align(volume)
            if not report.frames:
                near = chosen.display.near_field
                report.near_field_m = near_field_depth(volume, recording.positions) if near is None else near
                report.shape, report.axes = volume.values.shape, ", ".join(volume.names)
                report.spacing_m, report.origin_m = tuple(volume.spacing), volume.origin
            shown, projections = project_below_depth(volume, report.near_field_m)
            writer.add(frame, volume, projections=projections, near_field=report.near_field_m)
            axis: Axis = "z" if volume.dimensions == 3 else "y"
            if chosen.display.changes_values:
                shown = project(chosen.display.apply(crop_depth(volume, report.near_field_m)))
            pictures.append(shown[axis])
            report.frames.append(_frame_report(frame, volume, recording, shots))
            report.frames[-1].shift = shift
            report.frames[-1].motion = motions[-1] if motions else None
            report.device = volume.info.device if volume.info else ""
    made = round(time.perf_counter() - began, 3)
    labels = [str(frame) for frame, _ in choices]
    visible, path = crop_depth(volume, report.near_field_m), output / f"mip-{axis}.png"
    report.scale_ends = {axis: draw_contact_sheet(pictures, labels, visible, axis, path, chosen.display)}
    report.seconds = {"reconstruct and write": made, "draw": round(time.perf_counter() - began - made, 3)}
    report.files = [
        "series.h5",
        path.name,
        *_draw_motion(report, [frame for frame, _ in choices], output),
        "report.json",
    ]
    write_json(output / "report.json", report)
    return report


def series_in_memory(
    scan: Path,
    parameters: ReconstructionParameters,
    *,
    wavelength: float | None = None,
    average: bool = False,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> Series:
    """Reconstruct all frames of a scan file into memory; raises as :func:`reconstruct_series`."""
    choices = series_choices(measured(list_frames(scan)), wavelength=wavelength, average=average)
    made = [volume for _, volume, *_ in _volumes(scan, choices, parameters, None, progress, cancelled)]
    return Series([frame for frame, _ in choices], made.__getitem__)


def _volumes(
    scan: Path,
    choices: Choices,
    parameters: ReconstructionParameters,
    plans: PlanCache | None,
    progress: Progress | None,
    cancelled: CancelCheck | None,
    motions: list[MotionReport] | None = None,
) -> Iterator[tuple[SeriesFrame, Volume, Recording, ShotVariation]]:
    """Reconstruct the volumes of a series one after another; yield frame, volume, recording and its shots.

    With a list of ``motions``, the motion within each frame is undone and its report appended.
    """
    plans, before, highest = plans or PlanCache(most=1), dict[float, Volume](), None
    latest: Volume | None = None
    for number, (frame, choice) in enumerate(choices):
        step = _step_of(progress, number, len(choices))
        recording, shots = normalise_shots(open_recording(scan, choice), parameters.shots, cancelled=cancelled)
        if highest is None and parameters.highest_frequency == "signal":
            traces = preprocess(recording, parameters)
            highest = resolve_upper_frequency("signal", traces, recording.sampling_interval)
        common = parameters if highest is None else parameters.replace(highest_frequency=highest)
        acquisition, (geometry, grid, method, compute) = prepare(recording, common, progress=step, cancelled=cancelled)
        options: dict[str, Any] = {"progress": step, "cancelled": cancelled}
        moved = None
        if motions is not None:
            setup = ReconstructionSetup(geometry, grid, method, compute)
            moved, found = correct_motion(recording, acquisition, setup, **options)
            motions.append(found)
        with request_field_names():
            if moved is not None:
                volume = moved
            elif isinstance(method, DirectMethod):
                plan = plans.get(geometry, grid, method, compute)
                made = plan.run(acquisition.traces, **options)
                assert isinstance(made, Volume)  # noqa: S101 - one set of traces
                volume = made
            else:
                start = before.get(frame.excitation, latest)
                volume = reconstruct(acquisition, grid, method, start=start, compute=compute, **options)
        before[frame.excitation] = latest = volume
        yield frame, volume, recording, shots


def _add_notes(report: SeriesReport, first: Recording, chosen: ReconstructionParameters) -> None:
    """Add the notes that hold for all volumes: on depth, weights, film and regulariser."""
    report.notes += notes_on_depth(first, chosen)
    if chosen.method not in METHODS_WITHOUT_WEIGHTS:
        report.sensed_area_m2 = float(weights_of(first, chosen).sum())
        report.notes += notes_on_weights(first, report.sensed_area_m2)
    elif chosen.method == "iterative" and chosen.iterative.regularisation not in ("none", "thresholding"):
        report.notes.append(SHRINKAGE_NOTE)
    report.notes += chosen.film.notes(film_of(first))


def _draw_motion(report: SeriesReport, frames: list[SeriesFrame], output: Path) -> list[str]:
    """Draw shifts between and motion within frames, as far as they were looked for; return the files' names."""
    names = []
    if any(frame.shift is not None for frame in report.frames):
        names.append("shifts.png")
        draw_shifts(frames, [frame.shift for frame in report.frames], output / names[-1])
    for number, frame in enumerate(report.frames):
        if frame.motion is not None:
            names.append(f"motion-{number}.png")
            draw_motion(frame.motion, output / names[-1])
    return names


def _step_of(progress: Progress | None, number: int, count: int) -> Progress | None:
    """Return a progress callback for one volume: stages are named with its number."""
    if progress is None:
        return None
    return lambda stage, done, total: progress(f"volume {number + 1} of {count}, {stage}", done, total)


def _frame_report(frame: SeriesFrame, volume: Volume, recording: Recording, shots: ShotVariation) -> FrameReport:
    info = volume.info
    residuals = info.residuals if info else ()
    return FrameReport(
        frame.numbers,
        frame.excitation,
        frame.time,
        len(recording.positions),
        recording.planned,
        shots,
        (*recording.notes, *(info.notes if info else ())),
        info.iterations if info and info.iterations else None,
        residuals[-1] if residuals else None,
        float(np.max(volume.values)),
    )


def _with_speed(report: SeriesReport) -> dict[str, Any]:
    if report.parameters.get("medium"):
        return report.parameters
    return report.parameters | {"sound_speed": report.sound_speed_m_s}
