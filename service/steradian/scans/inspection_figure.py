"""Figure of an inspection: histogram, noise spectrum, and maps of power, baseline and arrival time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from steradian.core.atomic_files import atomic_write

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from steradian.scans.inspection import Inspection

MARKS: Final = {"dead": "x", "noisy": "+", "inverted": "v", "saturated": "^", "shifted": "o"}
"""Marker of each kind of bad A-line."""


def draw_inspection(found: Inspection, path: Path) -> None:
    """Draw the figure of an inspection as a PNG (atomic write)."""
    from matplotlib.figure import Figure

    told = found.signals
    figure = Figure(figsize=(11.0, 7.0), dpi=110, layout="constrained")
    axes = figure.subplots(2, 3)
    histogram, spectrum = axes[0, :2]
    histogram.stairs(np.maximum(told.counts, 0.5), told.edges, fill=True)
    histogram.set_yscale("log")
    histogram.set_xlabel("code of the digitiser" if told.histogram_kind == "codes" else "value")
    histogram.set_ylabel("samples")
    spectrum.semilogy(1e-6 * told.frequencies, told.spectrum_mean, label="mean")
    spectrum.semilogy(1e-6 * told.frequencies, told.spectrum_median, label="median")
    spectrum.set_xlabel("frequency (MHz)")
    spectrum.set_ylabel("noise power (a. u.)")
    spectrum.legend(fontsize=8)
    _map(found, axes[0, 2], told.power, "power (a. u.)")
    _map(found, axes[1, 0], told.baseline_mean, "baseline mean")
    _map(found, axes[1, 1], told.baseline_variance, "baseline variance")
    _map(found, axes[1, 2], 1e6 * told.arrival, "arrival (µs)")
    counts = ", ".join(f"{count} {kind} ({MARKS[kind]})" for kind, count in found.kinds.items()) or "none found"
    figure.suptitle(f"{len(told.power)} A-lines of frame {found.frame}; bad: {counts}", fontsize=10)
    with atomic_write(path) as file:
        figure.savefig(file, format="png")


def _map(found: Inspection, axes: Axes, values: NDArray[np.floating[Any]], title: str) -> None:
    """Draw values at the sensor positions as a colour map, with bad A-lines marked."""
    places = 1e3 * found.recording.positions
    y = places[:, 1] if places.shape[1] > 1 else np.zeros(len(places))
    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite, (1, 99)) if len(finite) else (0.0, 1.0)
    size = float(np.clip(40_000 / max(len(places), 1), 1, 40))
    drawn = axes.scatter(places[:, 0], y, c=values, s=size, vmin=low, vmax=high, marker="s", linewidths=0)
    axes.figure.colorbar(drawn, ax=axes)
    for kind, mark in MARKS.items():
        bad = [line.aline for line in found.signals.bad if line.kind == kind]
        axes.plot(places[bad, 0], y[bad], mark, color="tab:red", markersize=5, fillstyle="none", linewidth=0)
    axes.set_aspect("equal" if places.shape[1] > 1 else "auto")
    axes.set_title(title, fontsize=9)
    axes.set_xlabel("x (mm)")
    axes.set_ylabel("y (mm)")
