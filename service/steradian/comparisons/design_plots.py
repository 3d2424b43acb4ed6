"""Figure of a scan design: expected contrast and width over the number of points."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from steradian.comparisons.design_result import ScanDesign
from steradian.drawing import display_dispatch
from steradian.drawing.mpl_style import page, points, save, set_title, style_axes
from steradian.drawing.style import FOREGROUND, SECONDARY, TICK

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH, SHAPE = 1320, 0.46
COLOURS = ("tab:blue", "tab:orange", "tab:green", "tab:purple", "tab:brown")
MARKS = "os^Dv"


@display_dispatch.plot.register(ScanDesign)
def _plot_design(design: ScanDesign, axes: Axes | None = None) -> Axes:
    from steradian.drawing.notebook import resolve_axes

    axes = resolve_axes(axes)
    draw_trade(design, axes)
    return axes


@display_dispatch.save.register(ScanDesign)
def _save_design(design: ScanDesign, path: Path) -> None:
    save(design_figure(design), path)


def design_figure(design: ScanDesign, *, width: int = WIDTH) -> Figure:
    """Return a matplotlib figure of a scan design, without saving."""
    figure = page(width, SHAPE)
    left, right = figure.subplots(1, 2)
    draw_trade(design, left)
    _draw_widths(design, right)
    micrometres = f"{1e6 * design.diameter:.4g} µm"
    deep = f"{1e3 * design.place[2]:.4g} mm"
    set_title(
        figure, f"{design.pulses:,} pulses of {design.noise.decibels:.1f} dB: a vessel of {micrometres}, {deep} deep"
    )
    return figure


def draw_trade(design: ScanDesign, axes: Axes) -> None:
    """Draw the expected contrast over the number of points, with the limits by side lobes alone; proposals ringed."""
    for place, arrangement in enumerate(design.arrangements):
        colour = COLOURS[place % len(COLOURS)]
        for method in design.methods:
            splits = design.of(arrangement, method)
            if not splits:
                continue
            counts = [each.points for each in splits]
            line = "-" if method == "direct" else "--"
            axes.plot(
                counts,
                [each.expected.contrast_db for each in splits],
                line,
                color=colour,
                marker=MARKS[place % len(MARKS)],
                markersize=points(6),
                label=f"{arrangement}, {method}",
            )
            if method == "direct":
                axes.plot(counts, [each.expected.side_lobes_db for each in splits], ":", color=colour, linewidth=1)
            proposed = design.proposal(arrangement, method)
            if proposed is not None:
                axes.plot(
                    proposed.points,
                    proposed.expected.contrast_db,
                    "o",
                    markersize=points(16),
                    mfc="none",
                    mec=FOREGROUND,
                )
    axes.set_xscale("log")
    style_axes(axes, title="dotted: without noise; ring: proposed", across="points", up="contrast (dB)")
    axes.legend(fontsize=points(TICK), frameon=False)


def _draw_widths(design: ScanDesign, axes: Axes) -> None:
    for place, arrangement in enumerate(design.arrangements):
        for method in design.methods:
            splits = [each for each in design.of(arrangement, method) if each.usable]
            if not splits:
                continue
            axes.errorbar(
                [each.points for each in splits],
                [1e6 * each.expected.width for each in splits],
                yerr=[1e6 * each.expected.width * each.expected.width_scatter for each in splits],
                color=COLOURS[place % len(COLOURS)],
                linestyle="-" if method == "direct" else "--",
                marker=MARKS[place % len(MARKS)],
                markersize=points(6),
                capsize=points(3),
            )
    axes.axhline(1e6 * design.diameter, color=SECONDARY, linewidth=1)
    axes.set_xscale("log")
    style_axes(axes, title="width across the vessel; line: its diameter", across="points", up="width (µm)")
