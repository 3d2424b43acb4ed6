"""Alignment of the volumes of a series while they are made: shifts, report and chart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from steradian.core.atomic_files import atomic_write
from steradian.core.exceptions import InvalidInput
from steradian.imaging import Volume
from steradian.quality.registration import Shift, estimate_shift
from steradian.reconstructions.series.frames import SeriesFrame


@dataclass
class ShiftReport:
    """Shift of the object of a volume from its place in the first one, as written to ``report.json``.

    Parameters
    ----------
    metres, standard_error
        Along each axis in m, and its standard error (68 %).
    corrected
        Whether it was undone: it exceeds twice its standard error along an axis.
    """

    metres: tuple[float, ...]
    standard_error: tuple[float, ...]
    corrected: bool

    @classmethod
    def of(cls, shift: Shift) -> ShiftReport:
        """Return the report of a shift."""
        return cls(shift.metres, shift.standard_error, shift.is_significant)


class Aligner:
    """Aligner of volumes to the first one that it is given."""

    def __init__(self) -> None:
        self._reference: Volume | None = None

    def align(self, volume: Volume) -> tuple[Volume, ShiftReport | None]:
        """Return the volume with a significant shift undone, and the report; None for a volume without an object."""
        if self._reference is None:
            self._reference = volume
        try:
            shift = estimate_shift(self._reference, volume)
        except InvalidInput:
            return volume, None
        except np.linalg.LinAlgError:  # nothing but noise: no slope to compare
            return volume, None
        report = ShiftReport.of(shift)
        return (shift.undo(volume) if report.corrected else volume), report


def draw_shifts(frames: Sequence[SeriesFrame], shifts: Sequence[ShiftReport | None], path: Path) -> None:
    """Draw the shifts of the volumes with their standard errors over time, or by number, as a PNG (atomic write)."""
    from matplotlib.figure import Figure

    known = [number for number, shift in enumerate(shifts) if shift is not None]
    times = [frames[number].time for number in known]
    timed = all(time is not None for time in times)
    places = np.array(times if timed else known, np.float64)
    figure = Figure(figsize=(6.0, 3.6), dpi=110, layout="constrained")
    axes = figure.add_subplot()
    found = [shift for shift in shifts if shift is not None]
    names = ("x", "y", "z") if found and len(found[0].metres) == 3 else ("x", "z")
    for axis, name in enumerate(names if found else ()):
        values, errors = (1e6 * np.array([getattr(each, of)[axis] for each in found])
                          for of in ("metres", "standard_error"))  # fmt: skip
        axes.errorbar(places, values, errors, marker="o", markersize=3, capsize=2, label=name)
    if found:
        axes.legend()
    axes.set_xlabel("time (s)" if timed else "volume")
    axes.set_ylabel("shift of the object (µm)")
    axes.set_title(f"{sum(each.corrected for each in found)} of {len(shifts)} volumes corrected", fontsize=10)
    with atomic_write(path) as file:
        figure.savefig(file, format="png")
