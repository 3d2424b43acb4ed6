"""Pictures of a volume: maximum-intensity projections with axes in millimetres and a scale bar."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from steradian.imaging import Volume
from steradian.imaging.conditioning import Display

Axis = Literal["x", "y", "z"]
PLANES: dict[Axis, tuple[Axis, Axis]] = {"x": ("y", "z"), "y": ("x", "z"), "z": ("x", "y")}
"""The two axes that a projection along the third one shows, across and up (depth points down)."""

LINEAR = Display()
LONG_SIDE = 6.5
ROUND_LENGTHS = (0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50)


def draw_mip(volume: Volume, axis: Axis, path: Path, display: Display = LINEAR) -> None:
    """Draw the projection along ``axis`` into a PNG, under a temporary name first.

    Negative values, which a limited view and the record's finite band leave, are shown black.

    Parameters
    ----------
    volume
        The image, with ``display`` applied.
    axis
        The axis to project along; of an image [x, z] from a line of sensors, ``y`` shows the image itself.
    path
        Where to.
    display
        What was applied: whether values are decibels, and down to how many.
    """
    across, up = PLANES[axis]
    lowest = -display.log_range_db if display.log_range_db else 0.0
    projected = volume.mip(axis) if volume.dimensions == 3 else volume.values
    image = np.clip(projected, lowest, None).T
    horizontal, vertical = (1e3 * getattr(volume.axes, name) for name in (across, up))
    dx, dy = horizontal[1] - horizontal[0], vertical[1] - vertical[0]
    extent = (horizontal[0] - dx / 2, horizontal[-1] + dx / 2, vertical[-1] + dy / 2, vertical[0] - dy / 2)
    width, height = extent[1] - extent[0], extent[2] - extent[3]
    scale = LONG_SIDE / max(width, height)
    figure = Figure(
        figsize=(max(2.5, width * scale) + 1.6, max(2.0, height * scale) + 1.1), dpi=110, layout="constrained"
    )
    axes = figure.add_subplot()
    shown = axes.imshow(image, cmap="inferno", extent=extent, vmin=lowest, interpolation="nearest")
    if up == "y":
        axes.invert_yaxis()  # y points up, depth z points down from the sensor plane
    axes.set_xlabel(f"{across} (mm)")
    axes.set_ylabel(f"{up} (mm)" if up == "y" else "z, depth (mm)")
    title = f"Maximum-intensity projection along {axis}" if volume.dimensions == 3 else "Image below the line"
    axes.set_title(title, fontsize=10)
    label = "initial pressure (dB of its maximum)" if lowest else "initial pressure (arb. u.)"
    figure.colorbar(shown, ax=axes, label=label, shrink=0.8)
    _scale_bar(axes, width, height, up == "y")
    draft = path.with_name(path.name + ".new")
    figure.savefig(draft, format="png")
    draft.replace(path)


def _scale_bar(axes, width: float, height: float, upward: bool) -> None:  # type: ignore[no-untyped-def]
    """Put a bar of a round length, about a fifth of the width, into the lower left corner."""
    length = max((r for r in ROUND_LENGTHS if r <= width / 4), default=ROUND_LENGTHS[0])
    left, right = axes.get_xlim()
    bottom = axes.get_ylim()[0]
    direction = 1 if upward else -1
    x, y = left + 0.04 * (right - left), bottom + direction * 0.05 * height
    axes.add_patch(Rectangle((x, y), length, direction * 0.012 * max(width, height), color="white"))
    label = f"{length:g} mm" if length >= 1 else f"{1e3 * length:g} µm"
    axes.text(x + length / 2, y + direction * 0.03 * max(width, height), label, color="white", ha="center", fontsize=9)
