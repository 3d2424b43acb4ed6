"""Estimation of the speed of sound: speed of the least model misfit, with image sharpness as a function of speed.

The speed found is that at which a compact, non-negative image fits the A-lines best (:mod:`.medium_fit`). The
search begins at the sharpest image, whose speed alone is biased by the aperture and the object. Sensors on a line, and
records too long for the forward model, have the speed of the sharpest image.

Sharpness is the paper's Tenenbaum function of the z-projection (appendix B; Treeby et al. 2011 chose speeds with it),
over the projection's mean square, so that the image's scale, which changes with the speed, does not count. The A-lines
are thinned to the band that a coarse lateral grid carries: dozens of images then cost about as much as one full one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.core.quantity_ranges import SOUND_SPEED
from steradian.imaging import Layer, Medium
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.pipeline.resolve import (
    begins_at,
    depth_range_of,
    modes_of,
    preprocess,
    request_field_names,
    sound_speed_of,
    weights_of,
)
from steradian.reconstructions.pipeline.run import write_json
from steradian.reconstructions.shot_normalisation import normalise_shots
from steradian.reconstructions.studies.medium_fit import MediumFit, most_steps
from steradian.reconstructions.studies.medium_unknowns import MediumState, Unknown
from steradian.reconstructions.studies.sound_speed_curve import SoundSpeedCurve, draw_curve
from steradian.reconstructions.studies.sound_speed_images import Views
from steradian.scans.frames import FrameChoice
from steradian.scans.opening import FIRST, open_recording

FINE_STEP = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""Speeds around the best of the first round, in its steps, through which a parabola is laid."""
BOOTSTRAP_GROUPS = 6
"""Groups of sensors, one left out at a time for the standard error (jackknife)."""
BY_SHARPNESS = "the speed is that of the sharpest image; its error does not include the bias of that criterion"


def scan_sound_speed(
    scan: Path,
    output: Path,
    parameters: ReconstructionParameters | None = None,
    *,
    first: float = 1380.0,
    last: float = 1620.0,
    steps: int = 25,
    frame: int | FrameChoice = FIRST,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> SoundSpeedCurve:
    """Estimate the speed of sound of a recording and write ``sound-speed.json`` and ``sound-speed.png``.

    Parameters
    ----------
    scan
        A scan file or another known recording.
    output
        Folder for the results.
    parameters
        Conditioning, weights, depth range (at the recording's own speed) and tolerance of the images; their method is
        always the direct one.
    first, last, steps
        Speeds of the first round, in m/s: ``steps`` of them, ends included.
    frame
        Which frame, or which frames' mean, of a scan that has several; by default the first, with a note.
    progress, cancelled
        Reported and asked after each image.

    Raises
    ------
    NotFound, DamagedFile
        When the recording cannot be read.
    InvalidInput
        When the range is impossible or a parameter does not fit the recording.
    Cancelled
        When ``cancelled`` said so.
    """
    chosen = parameters or ReconstructionParameters()
    if chosen.medium is not None:
        raise InvalidInput("medium", f"{len(chosen.medium)} layers", "none: scan_medium searches in layers")
    recording, _ = normalise_shots(open_recording(scan, frame), chosen.shots, progress=progress, cancelled=cancelled)
    known = chosen if chosen.sound_speed or recording.sound_speed else chosen.replace(sound_speed=(first + last) / 2)
    depth, speed = depth_range_of(recording, known), sound_speed_of(recording, known)
    with request_field_names():
        curve = find_sound_speed(
            preprocess(recording, chosen),
            recording.positions,
            np.linspace(*_checked(first, last, steps)),
            sampling_interval=recording.sampling_interval,
            aperture=recording.aperture,
            modes=modes_of(recording, known),
            weights=weights_of(recording, known),
            depth_times=depth and (depth[0] / speed, depth[1] / speed),
            time_zero=begins_at(recording, known),
            progress=progress,
            cancelled=cancelled,
        )
    curve = replace(curve, notes=(*recording.notes, *curve.notes))
    output.mkdir(parents=True, exist_ok=True)
    write_json(output / "sound-speed.json", curve)
    draw_curve(curve, output / "sound-speed.png")
    return curve


def find_sound_speed(
    traces: NDArray[Any],
    positions: NDArray[np.float64],
    sound_speeds: Sequence[float] | NDArray[np.float64],
    *,
    sampling_interval: float,
    aperture: float,
    modes: int | None = None,
    weights: Any = None,
    depth_times: tuple[float, float] | None = None,
    time_zero: float = 0.0,
    standard_error: bool = True,
    criterion: Literal["misfit", "sharpness"] = "misfit",
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> SoundSpeedCurve:
    """Estimate the speed of sound from A-lines in memory.

    Parameters
    ----------
    traces, positions, sampling_interval, aperture, weights, time_zero
        A-lines (M, N_t), sensors (M, 2) or (M,) in m, dt in s, side of the aperture in m, areas (M,) of the sensors'
        cells in m² (None: Voronoi cells), and time of the first sample in s.
    sound_speeds
        Speeds of the first round in m/s, rising evenly, at least 3.
    modes
        Most lateral modes; None: one each 120 µm.
    depth_times
        First and last depth as times of flight in s; None: all of the record.
    standard_error
        Give the standard error.
    criterion
        What the speed is found by; sensors on a line: always the sharpness.
    progress, cancelled
        Reported and asked after each image.

    Raises
    ------
    InvalidInput
        When the speeds are not at least 3, rising evenly, or another parameter is out of range.
    Cancelled
        When ``cancelled`` said so.
    """
    speeds = np.asarray(sound_speeds, np.float64)
    gaps = np.diff(speeds)
    if speeds.ndim != 1 or len(speeds) < 3 or not (gaps > 0).all() or not np.allclose(gaps, gaps[0], rtol=1e-6):
        raise InvalidInput(
            "sound_speeds", f"an array of shape {speeds.shape}", "at least 3 speeds, rising evenly (m/s)"
        )
    step = float(gaps[0])
    fit, note = None, BY_SHARPNESS if criterion == "misfit" else None
    views = Views(traces, positions, sampling_interval, aperture, modes, weights, depth_times, time_zero)
    if criterion == "misfit" and np.ndim(positions) == 2:
        unknown = Unknown("layer1.sound_speed", float(speeds[0]), float(speeds[-1]))
        start = MediumState(Medium([Layer(float(speeds.mean()))]), time_zero)
        try:
            fit = MediumFit(
                traces, positions, sampling_interval, aperture, start, [unknown], depth_times, views.tell
            )  # fmt: skip
        except InvalidInput as refusal:
            note = f"{BY_SHARPNESS} ({refusal})"
    groups = BOOTSTRAP_GROUPS if fit is None and standard_error and len(positions) >= 4 * BOOTSTRAP_GROUPS else 0
    more = len(FINE_STEP) * (1 + groups) if fit is None else most_steps(1)
    views.report(progress, cancelled, len(speeds) + more)
    curve = {float(speed): views.sharpness(float(speed)) for speed in speeds}
    top = max(curve, key=lambda speed: curve[speed])
    edge = top in (speeds[0], speeds[-1])
    if fit is not None:
        found = fit.find(start if edge else start.with_values({unknown: top}))
        views.finish()
        best = float(found.values[0])
        edge = best in (speeds[0], speeds[-1])
        error = float(found.covariance[0, 0] ** 0.5) if standard_error and not edge else None
        higher = -1e-7 * (found.speed_per_delay or 0.0)
        trade = f"if the record begins 100 ns earlier than stated, the speed is {higher:.1f} m/s higher"
        return SoundSpeedCurve(tuple(curve), tuple(curve.values()), best, error, edge, (trade,))
    notes = () if note is None else (note,)
    if edge:
        return SoundSpeedCurve(tuple(curve), tuple(curve.values()), top, None, True, notes)
    near = [top + step * f for f in FINE_STEP]
    curve |= {speed: views.sharpness(speed) for speed in near}
    best, error = _parabola_vertex(near, [curve[speed] for speed in near]), None
    if groups:
        member = np.random.default_rng(0).permutation(len(positions)) % groups
        others = [
            _parabola_vertex(near, [views.sharpness(speed, member != g) for speed in near]) for g in range(groups)
        ]
        error = float(np.sqrt((groups - 1) * np.var(others)))
    order = sorted(curve)
    return SoundSpeedCurve(tuple(order), tuple(curve[speed] for speed in order), best, error, False, notes)


def _parabola_vertex(x: Sequence[float], y: Sequence[float]) -> float:
    """Return the position of the maximum of a least-squares parabola, limited to the range of the points."""
    middle = float(np.mean(x))
    a, b, _ = np.polyfit(np.asarray(x) - middle, y, 2)
    if a >= 0:
        return float(x[int(np.argmax(y))])
    return float(np.clip(middle - b / (2 * a), min(x), max(x)))


def _checked(first: float, last: float, steps: int) -> tuple[float, float, int]:
    if not (first in SOUND_SPEED and last in SOUND_SPEED and first < last):
        raise InvalidInput("first, last", (first, last), f"rising, each {SOUND_SPEED}")
    if steps != int(steps) or not 3 <= steps <= 1001:
        raise InvalidInput("steps", steps, "a whole number from 3 to 1001")
    return float(first), float(last), int(steps)
