"""Motion of the object within a scan: its estimate, the corrected image, report and chart."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from steradian.core.atomic_files import atomic_write
from steradian.core.exceptions import InvalidInput
from steradian.core.progress import CancelCheck, Progress
from steradian.imaging import Acquisition, DirectMethod, ImageGrid, Volume
from steradian.imaging.motion import Motion, estimate_motion, reconstruct_moving
from steradian.reconstructions.pipeline.resolve import ReconstructionSetup, request_field_names
from steradian.scans.recording import Recording

MOST_MODES = 96
"""Lateral modes of the images that motion is estimated from, at most."""
PARTS, LEAST_SPREAD = 10, 0.35
"""Parts of a scan's time, and least spread of the sensors of a part, relative to that of all, in the mean over parts:
0.76 in progressive order, 0.18 along lines."""


@dataclass
class MotionReport:
    """Motion found within a scan, as written to ``report.json``.

    Parameters
    ----------
    corrected
        Whether the image was corrected: the motion exceeds twice its standard error along an axis.
    times_s
        Knots in s since the first shot.
    shifts_m
        Shift of the object along x, y, z at each knot in m, about its mean.
    standard_error_m
        Standard error of the shifts along x, y, z in m (68 %).
    """

    corrected: bool
    times_s: tuple[float, ...]
    shifts_m: tuple[tuple[float, ...], ...]
    standard_error_m: tuple[float, ...]

    @classmethod
    def of(cls, motion: Motion) -> MotionReport:
        """Return the report of a motion."""
        errors = np.sqrt(np.mean(np.square(motion.standard_errors), axis=0))
        shifts = tuple(tuple(map(float, row)) for row in motion.shifts)
        return cls(motion.is_significant, tuple(map(float, motion.times)), shifts, tuple(map(float, errors)))

    @property
    def rms_m(self) -> tuple[float, ...]:
        """Root mean square of the shifts along x, y, z in m."""
        return tuple(map(float, np.sqrt(np.mean(np.square(self.shifts_m), axis=0))))


def correct_motion(
    recording: Recording,
    acquisition: Acquisition,
    setup: ReconstructionSetup,
    *,
    progress: Progress | None = None,
    cancelled: CancelCheck | None = None,
) -> tuple[Volume | None, MotionReport]:
    """Estimate the motion within a scan; return the corrected image, or None where it is not significant, and a report.

    Parameters
    ----------
    recording
        Normalised A-lines with the times of their shots.
    acquisition, setup
        The A-lines and arguments of the reconstruction.

    Raises
    ------
    InvalidInput
        If times are not known, the order of the shots follows the places, the method is iterative, or the sensors or
        the medium do not allow it.
    Cancelled
        If ``cancelled`` returned true.
    """
    if not isinstance(setup.method, DirectMethod):
        raise InvalidInput("motion", "true", "a direct method: iterative images of moving objects are not made")
    times = recording.times
    if times is None:
        allowed = (
            "one frame of a scan file with the times of its shots (fire_time_s), or their numbers and a pulse rate"
        )
        raise InvalidInput("motion", "true", allowed)
    if (spread := _spread_of_parts(recording.positions, times)) < LEAST_SPREAD:
        value = f"an order in which a tenth of the scan sees {100 * spread:.0f} % of the aperture"
        raise InvalidInput("motion", value, "an order in which each tenth sees most of it, such as progressive")
    modes = np.minimum(setup.grid.modes, MOST_MODES).tolist()
    coarse = ImageGrid(modes, depth=setup.grid.depth)
    with request_field_names():
        motion = estimate_motion(
            acquisition, times, coarse, compute=setup.compute, progress=progress, cancelled=cancelled
        )
        image = None
        if motion.is_significant:
            image = reconstruct_moving(acquisition, times, motion, setup.grid, setup.method, compute=setup.compute)
    return image, MotionReport.of(motion)


def draw_motion(report: MotionReport, path: Path) -> None:
    """Draw the shifts over the time of the scan with their standard errors, as a PNG (atomic write)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.0, 3.6), dpi=110, layout="constrained")
    axes = figure.add_subplot()
    times, shifts = np.array(report.times_s), 1e6 * np.array(report.shifts_m)
    for number, (name, colour) in enumerate(zip("xyz", ("tab:blue", "tab:orange", "tab:green"), strict=True)):
        error = 1e6 * report.standard_error_m[number]
        axes.plot(times, shifts[:, number], color=colour, label=f"{name} ± {error:.2g} µm")
        axes.fill_between(times, shifts[:, number] - error, shifts[:, number] + error, color=colour, alpha=0.2)
    axes.legend()
    axes.set_xlabel("time since the first shot (s)")
    axes.set_ylabel("shift of the object (µm)")
    axes.set_title("corrected" if report.corrected else "within twice its error: not corrected", fontsize=10)
    with atomic_write(path) as file:
        figure.savefig(file, format="png")


def _spread_of_parts(positions: NDArray[np.float64], times: NDArray[np.float64]) -> float:
    """Return the standard deviation of the positions within a part of the time over that of all: mean over parts."""
    order = np.argsort(times, kind="stable")
    whole = np.maximum(positions.std(axis=0), 1e-12)
    parts = np.array_split(order, min(PARTS, max(1, len(order) // 4)))
    return float(np.mean([(positions[part].std(axis=0) / whole).min() for part in parts]))
