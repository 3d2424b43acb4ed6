"""Picture of a search for the speed of sound."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from steradian.core.atomic_files import draft

if TYPE_CHECKING:
    from steradian.reconstructions.studies.sound_speed import SoundSpeedCurve


def draw_curve(curve: SoundSpeedCurve, path: Path) -> None:
    """Draw sharpness over speed, and the speed found, into a PNG, under a temporary name first."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.0, 3.6), dpi=110, layout="constrained")
    axes = figure.add_subplot()
    axes.plot(curve.sound_speeds, curve.sharpness, "o-", markersize=3, color="tab:blue")
    axes.axvline(curve.best, color="tab:red", linewidth=1)
    error = "" if curve.standard_error is None else f" ± {curve.standard_error:.2f}"
    axes.set_title(f"Found {curve.best:.1f}{error} m/s" + (" (end of the range)" if curve.at_edge else ""), fontsize=10)
    axes.set_xlabel("speed of sound (m/s)")
    axes.set_ylabel("sharpness of the z-projection")
    with draft(path) as file:
        figure.savefig(file, format="png")
