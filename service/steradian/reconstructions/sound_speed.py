"""The speed of sound that makes the image sharpest.

Sharpness is the paper's Tenenbaum function of the z-projection (appendix B; Treeby et al. 2011 chose speeds with it),
over the projection's mean square, so that the image's scale, which changes with the speed, does not count. The A-lines
are thinned to the band that a coarse lateral grid carries: dozens of images then cost about as much as one full one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.drafts import draft
from steradian.errors import Cancelled, InvalidInput
from steradian.imaging import reconstruct
from steradian.imaging.band import signal_band, thinned, thinning
from steradian.imaging.extent import Extent
from steradian.progress import IsCancelled, Progress
from steradian.quality import tenenbaum
from steradian.ranges import SOUND_SPEED
from steradian.reconstructions.job import write_json
from steradian.reconstructions.options import (
    begins_at,
    conditioned,
    depth_range_of,
    modes_of,
    sound_speed_of,
    weights_of,
)
from steradian.reconstructions.parameters import ReconstructionParameters
from steradian.reconstructions.shots import even_out
from steradian.scans.frames import FrameChoice
from steradian.scans.opening import FIRST, open_recording

SPACING = 120e-6
"""Lateral spacing of the images compared, in m, unless fewer modes are asked for."""
FINE = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""Speeds around the best of the first round, in its steps, through which a parabola is laid."""
GROUPS = 6
"""Groups of sensors, one left out at a time for the standard error (jackknife)."""
_STAGE = "sound speed"


@dataclass(frozen=True)
class SoundSpeedCurve:
    """Sharpness over the speed of sound.

    Parameters
    ----------
    sound_speeds, sharpness
        What was tried, rising, and the normalised sharpness there.
    best
        Speed of the maximum in m/s, from a parabola through the sharpest.
    standard_error
        Scatter of ``best``, in m/s, when groups of sensors are left out; the bias of the criterion is not in it.
        None where it was not asked for or the maximum is at the end of the range.
    at_edge
        The sharpest is the first or last speed: the range should be moved.
    notes
        What was decided or assumed about the recording.
    """

    sound_speeds: tuple[float, ...]
    sharpness: tuple[float, ...]
    best: float
    standard_error: float | None
    at_edge: bool
    notes: tuple[str, ...] = ()


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
    cancelled: IsCancelled | None = None,
) -> SoundSpeedCurve:
    """Find the speed of sound of a recording; write ``sound-speed.json`` and ``sound-speed.png`` into a folder.

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
    recording, _ = even_out(open_recording(scan, frame), chosen.shots)
    known = chosen if chosen.sound_speed or recording.sound_speed else chosen.replace(sound_speed=(first + last) / 2)
    depth, speed = depth_range_of(recording, known), sound_speed_of(recording, known)
    curve = find_sound_speed(
        conditioned(recording, chosen),
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
    curve = replace(curve, notes=recording.notes)
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
    progress: Progress | None = None,
    cancelled: IsCancelled | None = None,
) -> SoundSpeedCurve:
    """Find the speed of sound of A-lines in memory.

    Parameters
    ----------
    traces, positions, sampling_interval, aperture, weights, time_zero
        As in :func:`steradian.imaging.reconstruct`.
    sound_speeds
        Speeds of the first round in m/s, rising evenly, at least 3.
    modes
        Most lateral modes; None: one each 120 µm.
    depth_times
        First and last depth as times of flight in s; None: all of the record.
    standard_error
        Leave out groups of sensors to see the scatter.
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
    groups = GROUPS if standard_error and len(positions) >= 4 * GROUPS else 0
    views = _Views(traces, positions, sampling_interval, aperture, modes, weights, depth_times, time_zero)
    views.report(progress, cancelled, len(speeds) + len(FINE) * (1 + groups))
    curve = {float(speed): views.sharpness(float(speed)) for speed in speeds}
    top = max(curve, key=lambda speed: curve[speed])
    if top in (speeds[0], speeds[-1]):
        return SoundSpeedCurve(tuple(curve), tuple(curve.values()), top, None, True)
    near = [top + step * f for f in FINE]
    curve |= {speed: views.sharpness(speed) for speed in near}
    best = _vertex(near, [curve[speed] for speed in near])
    error = None
    if groups:
        member = np.random.default_rng(0).permutation(len(positions)) % groups
        others = [_vertex(near, [views.sharpness(speed, member != g) for speed in near]) for g in range(groups)]
        error = float(np.sqrt((groups - 1) * np.var(others)))
    order = sorted(curve)
    return SoundSpeedCurve(tuple(order), tuple(curve[speed] for speed in order), best, error, False)


class _Views:
    """Coarse images of one recording at many speeds."""

    def __init__(
        self,
        traces: NDArray[Any],
        positions: NDArray[np.float64],
        interval: float,
        aperture: float,
        modes: int | None,
        weights: Any,
        depth_times: tuple[float, float] | None,
        time_zero: float,
    ) -> None:
        most = max(32, round(aperture / SPACING))
        self._modes = most if modes is None else min(modes, most)
        highest, _ = signal_band(traces, interval)
        # a grid of that spacing carries waves along the film up to half a wave a point; 1500 m/s will do here
        carried = 0.5 * self._modes / aperture * 1500.0
        factor = thinning(min(highest, carried), interval)
        self._traces = thinned(traces, factor, "float32")
        self._interval = interval * factor
        self._positions, self._aperture = positions, aperture
        self._weights, self._times, self._zero = weights, depth_times, time_zero
        self._done = self._total = 0
        self._progress: Progress | None = None
        self._cancelled: IsCancelled | None = None

    def report(self, progress: Progress | None, cancelled: IsCancelled | None, total: int) -> None:
        self._progress, self._cancelled, self._total = progress, cancelled, total

    def sharpness(self, speed: float, some: NDArray[np.bool_] | None = None) -> float:
        if self._cancelled is not None and self._cancelled():
            raise Cancelled(f"cancelled during: {_STAGE}")
        which = slice(None) if some is None else some
        weights = self._weights
        if isinstance(weights, np.ndarray) and some is not None:
            weights = weights[some] * (weights.sum() / weights[some].sum())
        volume = reconstruct(
            self._traces[which],
            self._positions[which],
            sampling_interval=self._interval,
            sound_speed=speed,
            aperture=self._aperture,
            modes=self._modes,
            weights=weights,
            depth_range=self._depths(speed),
            time_zero=self._zero,
            tolerance=1e-3,
        )
        image = np.maximum(volume.mip("z") if volume.dimensions == 3 else volume.values, 0)
        self._done += 1
        if self._progress is not None:
            self._progress(_STAGE, self._done, self._total)
        square = float(np.mean(np.square(image, dtype=np.float64)))
        return tenenbaum(image) / square if square else 0.0

    def _depths(self, speed: float) -> tuple[float, float] | None:
        if self._times is None:
            return None
        end = (Extent.of(self._traces.shape[1], self._interval, self._zero).end - 1) * self._interval
        return self._times[0] * speed, min(self._times[1], end) * speed


def _vertex(x: Sequence[float], y: Sequence[float]) -> float:
    """Maximum of the least-squares parabola, within the points."""
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


def draw_curve(curve: SoundSpeedCurve, path: Path) -> None:
    """Draw sharpness over speed into a PNG, under a temporary name first."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.0, 3.6), dpi=110, layout="constrained")
    axes = figure.add_subplot()
    axes.plot(curve.sound_speeds, curve.sharpness, "o-", markersize=3, color="tab:blue")
    axes.axvline(curve.best, color="tab:red", linewidth=1)
    error = "" if curve.standard_error is None else f" ± {curve.standard_error:.2f}"
    axes.set_title(
        f"Sharpest at {curve.best:.1f}{error} m/s" + (" (end of the range)" if curve.at_edge else ""), fontsize=10
    )
    axes.set_xlabel("speed of sound (m/s)")
    axes.set_ylabel("sharpness of the z-projection")
    with draft(path) as file:
        figure.savefig(file, format="png")
