"""Figure that compares several masks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from steradian.comparisons.comparison import REGIONS, Comparison, Region
from steradian.comparisons.simulation import Method
from steradian.drawing.mpl_style import colour_bar, page, save, set_title, style_axes
from steradian.drawing.style import ACCENT, BACKGROUND, FOREGROUND, PLAIN, PRESSURE, TICK

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MM = 1e3
COLUMN, ROW = 300, 300
"""Width and height in pixels of a mask's pictures."""
SOLID_ANGLE_AXIS = "coolwarm"


def draw_comparison(comparison: Comparison, path: Path, *, width: int | None = None) -> None:
    """Draw a comparison of masks into a picture file; the suffix of the file's name determines the format.

    Parameters
    ----------
    comparison
        The comparison.
    path
        The file, for example ``compare.png``; written whole or not at all.
    width
        Of the page in pixels; ``None``: as many masks need.
    """
    save(comparison_figure(comparison, width=width), path)


def comparison_figure(comparison: Comparison, *, width: int | None = None) -> Figure:
    """Return a matplotlib figure of a comparison of masks, without saving."""
    names = list(comparison.masks)
    methods = comparison.methods
    rows = 2 + len(methods) + bool(methods)
    natural = COLUMN * max(3, len(names)) + 120
    figure = page(width or natural, (ROW * rows + 60) / natural, least=natural)
    cells = figure.subplots(rows, len(names), squeeze=False)
    for column, name in enumerate(names):
        last = column == len(names) - 1
        _draw_solid_angles(cells[0, column], comparison, name, last)
        _draw_ball(cells[1, column], comparison, name, last)
        for row, method in enumerate(methods):
            _draw_image(cells[2 + row, column], comparison, name, method, last)
        if column:
            for row in range(2 + len(methods)):
                cells[row, column].set_ylabel("")
                cells[row, column].tick_params(labelleft=False)
    if methods:
        grid = cells[-1, 0].get_gridspec()
        for axes in cells[-1]:
            axes.remove()
        groups = [(method, region) for method in methods for region in REGIONS]
        inner = grid[-1, :].subgridspec(1, len(groups))
        for place, (method, region) in enumerate(groups):
            plot = figure.add_subplot(inner[place])
            _draw_correlations(plot, comparison, method, region, named=place == 0)
    depth = MM * comparison.point_of_interest[2]
    set_title(figure, f"{len(names)} masks, point of interest {depth:.4g} mm deep")
    return figure


def _draw_solid_angles(axes: Axes, comparison: Comparison, name: str, last: bool) -> None:
    from steradian.masks.metrics import evaluate_mask

    mask = comparison.masks[name]
    angles = evaluate_mask(mask, comparison.point_of_interest).solid_angles
    assert angles is not None  # noqa: S101 - there is a point of interest
    x, y = MM * mask.positions.T
    size = float(np.clip(5_000 / mask.count, 0.3, 12))
    share = np.log2(angles / angles.mean())
    shown = axes.scatter(x, y, c=share, s=size, cmap=SOLID_ANGLE_AXIS, vmin=-2, vmax=2, linewidths=0)
    if last:
        bar = colour_bar(axes, shown, "solid angle / mean")
        bar.set_ticks([-2, -1, 0, 1, 2], labels=["¼", "½", "1", "2", "4"])
    half = 1.05 * MM * mask.aperture / 2
    axes.set(xlim=(-half, half), ylim=(-half, half))
    style_axes(axes, title=f"{name}\n{mask.count:,} points", across="x (mm)", up="y (mm)", equal=True)


def _draw_ball(axes: Axes, comparison: Comparison, name: str, last: bool) -> None:
    spread = comparison.spreads[name]
    extent = (MM * spread.x[0], MM * spread.x[-1], MM * spread.z[-1], MM * spread.z[0])
    shown = axes.imshow(
        spread.section.T, extent=extent, cmap=PRESSURE, vmin=-0.2, vmax=1, interpolation="bilinear", aspect="auto"
    )
    if last:
        colour_bar(axes, shown, "relative pressure")
    figures = comparison.promised[name]
    title = f"{1e6 * figures.lateral_m:.0f} × {1e6 * figures.axial_m:.0f} µm, {figures.contrast_db:.0f} dB"
    style_axes(axes, title=title, across="x (mm)", up="z, depth (mm)")


def _draw_image(axes: Axes, comparison: Comparison, name: str, method: Method, last: bool) -> None:
    simulation, simulated = comparison.simulation, comparison.simulated[name]
    assert simulation is not None  # noqa: S101 - there are images
    outcome = simulated.by[method]
    half = MM * comparison.masks[name].aperture / 2
    top = float(np.percentile(outcome.mip, 99.9))
    extent = (-half, half, -half, half)
    shown = axes.imshow(outcome.mip.T / top, origin="lower", extent=extent, cmap=PRESSURE, vmin=0, vmax=1)
    if last:
        colour_bar(axes, shown, "pressure / 99.9th percentile")
    turn = np.linspace(0, 2 * np.pi, 200)
    radius = MM * simulation.region / 2
    x, y = (MM * centre for centre in simulation.centre)
    axes.plot(x + radius * np.cos(turn), y + radius * np.sin(turn), ":", color=BACKGROUND, linewidth=1)
    axes.set(xlim=(-half, half), ylim=(-half, half))
    style_axes(axes, title=f"{method}: z-projection", across="x (mm)", up="y (mm)", equal=True)


def _draw_correlations(axes: Axes, comparison: Comparison, method: Method, region: Region, *, named: bool) -> None:
    """Draw a bar chart of each mask's correlation with the true object; the best is highlighted."""
    names = list(comparison.masks)
    ranking = comparison.ranking(region, method)
    found = dict(ranking)
    colours = [ACCENT if name == ranking[0][0] else PLAIN for name in names]
    bars = axes.barh(names, [found[name] for name in names], color=colours)
    axes.bar_label(bars, fmt="%.3f", padding=2, fontsize=TICK * 0.6, color=FOREGROUND)
    axes.set_xlim(min(0.0, *found.values()), 1.25)
    axes.set_xticks([0, 0.5, 1])
    axes.invert_yaxis()
    style_axes(axes, title=f"{method}:\n{REGIONS[region]}", across="correlation with the object")
    axes.tick_params(labelleft=named)
