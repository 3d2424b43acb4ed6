"""Contact sheet of a series: the projections of all its volumes side by side, with one colour scale."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steradian.core.atomic_files import atomic_write
from steradian.imaging import Volume
from steradian.imaging.signal.conditioning import Display
from steradian.reconstructions.volumes.images import PLANE_LABELS, Axis, display_range, extent_mm

MOST = 36
"""Projections on a sheet; of a longer series evenly chosen ones."""


def draw_contact_sheet(
    projections: Sequence[NDArray[Any]], labels: Sequence[str], volume: Volume, axis: Axis, path: Path, display: Display
) -> float:
    """Draw the projections of the volumes of a series as a PNG (atomic write).

    Parameters
    ----------
    projections
        Along ``axis``, one for each volume.
    labels
        Title of each.
    volume
        One of the volumes, for the axes.
    axis
        ``z``, or ``y`` for images from a line of sensors.
    path
        Where to.
    display
        Colour map, percentile and decibels.

    Returns
    -------
    float
        Value at the end of the scale, that of the brightest projection.
    """
    from matplotlib.figure import Figure

    chosen = np.unique(np.linspace(0, len(projections) - 1, min(MOST, len(projections))).round().astype(int))
    ranges = [display_range(projections[number], display) for number in chosen]
    lowest, highest = ranges[0][0], max(top for _, top, _ in ranges)
    across, up = PLANE_LABELS[axis]
    left, right = extent_mm(volume, across)
    first, last = extent_mm(volume, up)
    columns = min(len(chosen), max(2, math.ceil(math.sqrt(len(chosen)))))
    rows = math.ceil(len(chosen) / columns)
    high = 2.6 * min(2.0, max(0.4, (last - first) / (right - left)))
    figure = Figure(figsize=(2.6 * columns + 1.2, (high + 0.35) * rows + 0.6), dpi=110, layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for panel in panels.flat[len(chosen) :]:
        panel.set_axis_off()
    ends = (left, right, *((first, last) if up == "y" else (last, first)))
    for panel, number in zip(panels.flat, chosen, strict=False):
        image, origin = projections[number].T, "lower" if up == "y" else "upper"
        shown = panel.imshow(image, display.colour_map, vmin=lowest, vmax=highest, origin=origin, extent=ends)
        panel.set_title(labels[number], fontsize=9)
    figure.supxlabel(f"{across} (mm)", fontsize=9)
    figure.supylabel(f"{up} (mm)" if up == "y" else "z, depth (mm)", fontsize=9)
    bar = figure.colorbar(shown, ax=panels, shrink=0.9)
    bar.set_label("initial pressure (dB of its maximum)" if lowest else "initial pressure (arb. u.)", fontsize=9)
    with atomic_write(path) as file:
        figure.savefig(file, format="png")
    return highest
