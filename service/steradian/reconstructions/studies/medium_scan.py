"""Search for the parameters of the medium of a recording, with its report and plot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from steradian.core.atomic_files import atomic_write
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging import Acquisition
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.resolve import (
    begins_at,
    depth_range_of,
    medium_of,
    modes_of,
    preprocess,
    request_field_names,
    weights_of,
)
from steradian.reconstructions.pipeline.run import write_json
from steradian.reconstructions.shot_normalisation import normalise_shots
from steradian.reconstructions.studies.medium_search import FoundMedium, FoundParameter, find_medium
from steradian.scans.frames import FrameChoice
from steradian.scans.opening import FIRST, open_recording

SCALES = {"m/s": (1.0, "m/s"), "m": (1e3, "mm"), "s": (1e9, "ns")}
"""Factor and unit in which values of an SI unit are shown."""


def scan_medium(
    scan: Path,
    output: Path,
    parameters: ReconstructionParameters | None = None,
    search: Sequence[str] | None = None,
    *,
    span: float = 0.1,
    frame: int | FrameChoice = FIRST,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> FoundMedium:
    """Estimate the medium of a recording and write ``sound-speed.json`` and ``sound-speed.png``.

    Parameters
    ----------
    scan, output, frame, progress, cancelled
        As in :func:`.sound_speed_search.scan_sound_speed`.
    parameters
        Medium to begin at (None: the recording's speed), conditioning, weights and depth range.
    search, span
        As in :func:`.medium_search.find_medium`.

    Raises
    ------
    NotFound, DamagedFile
        When the recording cannot be read.
    InvalidInput
        When a parameter does not fit the recording.
    Cancelled
        When ``cancelled`` said so.
    """
    chosen = parameters or ReconstructionParameters()
    recording, _ = normalise_shots(open_recording(scan, frame), chosen.shots, progress=progress, cancelled=cancelled)
    with request_field_names():
        acquisition = Acquisition(
            preprocess(recording, chosen),
            recording.positions,
            dt=recording.sampling_interval,
            medium=medium_of(recording, chosen),
            t0=begins_at(recording, chosen),
            weights=weights_of(recording, chosen),
            aperture=recording.aperture,
        )
        found = find_medium(
            acquisition,
            search,
            span=span,
            modes=modes_of(recording, chosen),
            depth=depth_range_of(recording, chosen),
            progress=progress,
            cancelled=cancelled,
        )
    found = replace(found, notes=(*recording.notes, *found.notes))
    output.mkdir(parents=True, exist_ok=True)
    write_json(output / "sound-speed.json", found)
    draw_medium(found, output / "sound-speed.png")
    return found


def describe(parameter: FoundParameter) -> str:
    """Return a value with its error and unit, such as ``1482.1 ± 0.7 m/s``."""
    factor, unit = SCALES[parameter.unit]
    value, error = factor * parameter.value, factor * (parameter.standard_error or 0.0)
    digits = 4 if unit == "mm" else 2
    text = f"{value:.{digits}f}" + (f" ± {error:.{digits}f}" if parameter.standard_error is not None else "")
    return f"{text} {unit}" + (", at the end of the range" if parameter.at_edge else "")


def draw_medium(found: FoundMedium, path: Path) -> None:
    """Plot the criterion against each parameter with the value found, as a PNG (atomic write)."""
    from matplotlib.figure import Figure

    count = len(found.parameters)
    figure = Figure(figsize=(6.0, 2.6 * count), dpi=110, layout="constrained")
    for number, each in enumerate(found.parameters, start=1):
        factor, unit = SCALES[each.unit]
        axes = figure.add_subplot(count, 1, number)
        axes.plot([factor * value for value in each.values], each.criterion_values, "o-", markersize=2)
        axes.axvline(factor * each.value, color="tab:red", linewidth=1)
        if each.standard_error is not None:
            ends = (factor * (each.value + way * each.standard_error) for way in (-1, 1))
            axes.axvspan(*ends, color="tab:red", alpha=0.15, linewidth=0)
        axes.set_title(f"{each.name}: {describe(each)}", fontsize=10)
        axes.set_xlabel(f"{each.name} ({unit})")
        axes.set_ylabel(each.criterion)
    with atomic_write(path) as file:
        figure.savefig(file, format="png")
