"""Image sharpness as a function of the speed of sound, and its plot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from steradian.core.atomic_files import atomic_write


@dataclass(frozen=True)
class SoundSpeedCurve:
    """Estimated speed of sound, with image sharpness as a function of speed.

    Parameters
    ----------
    sound_speeds, sharpness
        What was tried, rising, and the normalised sharpness there.
    best
        Speed of the least misfit in m/s; by sharpness, from a parabola through the sharpest.
    standard_error
        Of ``best`` in m/s (68 %): noise and the fit's limits; by sharpness, the scatter when groups of sensors are
        left out, without the criterion's bias. None where it was not asked for or ``at_edge``.
    at_edge
        ``best`` is the first or last speed: the range should be moved.
    notes
        What was decided or assumed, and how the speed trades with a delay of the record.
    """

    sound_speeds: tuple[float, ...]
    sharpness: tuple[float, ...]
    best: float
    standard_error: float | None
    at_edge: bool
    notes: tuple[str, ...] = ()


def draw_curve(curve: SoundSpeedCurve, path: Path) -> None:
    """Plot sharpness against speed with the estimated speed, as a PNG (atomic write)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.0, 3.6), dpi=110, layout="constrained")
    axes = figure.add_subplot()
    axes.plot(curve.sound_speeds, curve.sharpness, "o-", markersize=3, color="tab:blue")
    axes.axvline(curve.best, color="tab:red", linewidth=1)
    error = "" if curve.standard_error is None else f" ± {curve.standard_error:.2f}"
    axes.set_title(f"Found {curve.best:.1f}{error} m/s" + (" (end of the range)" if curve.at_edge else ""), fontsize=10)
    axes.set_xlabel("speed of sound (m/s)")
    axes.set_ylabel("sharpness of the z-projection")
    with atomic_write(path) as file:
        figure.savefig(file, format="png")
