"""Summary figure of a scan plan."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from steradian.core.exceptions import InvalidInput
from steradian.drawing import display_dispatch
from steradian.drawing.mpl_style import (
    PICTURES,
    colour_bar,
    draw_histogram,
    page,
    points,
    save,
    set_title,
    style_axes,
)
from steradian.drawing.style import ACCENT, FOREGROUND, GAP, PLAIN, TICK, TIME
from steradian.plans.files import write_json
from steradian.plans.plan import ScanPlan
from steradian.plans.preview import PlanCost, preview

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MM = 1e3
WIDTH, SHAPE = 1320, 0.55
"""Width of the page in pixels, and its height over it."""


@display_dispatch.plot.register(ScanPlan)
def _plot_plan(plan: ScanPlan, axes: Axes | None = None) -> Axes:
    from steradian.drawing.notebook import resolve_axes

    axes = resolve_axes(axes)
    draw_path(plan, axes)
    return axes


@display_dispatch.save.register(ScanPlan)
def _save_plan(plan: ScanPlan, path: Path) -> None:
    ending = path.suffix.lower()
    if ending in PICTURES:
        draw_plan(plan, path)
    elif ending == ".json":
        write_json(plan, path)
    else:
        allowed = ".json; or .png, .pdf or .svg for a picture"
        raise InvalidInput("file", f"{path.name} ({ending or 'no ending'})", allowed)


def draw_plan(plan: ScanPlan, path: Path, cost: PlanCost | None = None, *, width: int = WIDTH) -> None:
    """Draw a plan's summary figure into a picture file; the suffix determines the format.

    Parameters
    ----------
    plan
        The plan.
    path
        The file, for example ``plan.png``; written whole or not at all.
    cost
        Its preview, if there is one already.
    width
        Of the page in pixels.
    """
    save(plan_figure(plan, cost, width=width), path)


def plan_figure(plan: ScanPlan, cost: PlanCost | None = None, *, width: int = WIDTH) -> Figure:
    """Return a matplotlib figure of a plan's summary, as drawn by :func:`draw_plan`, without saving."""
    cost = cost or preview(plan)
    figure = page(width, SHAPE)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.1, 1))
    draw_path(plan, figure.add_subplot(grid[:, 0]), cost)
    _draw_seconds(cost, figure.add_subplot(grid[0, 1]))
    _draw_moves(plan, figure.add_subplot(grid[1, 1]))
    order = str(plan.order).replace("_", " ")
    set_title(figure, f"Plan of {plan.mask.count:,} points at {plan.pulse_rate:g} Hz in the order {order!r}")
    return figure


def draw_path(plan: ScanPlan, axes: Axes, cost: PlanCost | None = None) -> None:
    """Draw the beam's path, coloured by time."""
    from matplotlib.collections import LineCollection

    cost = cost or preview(plan)
    path = MM * plan.path
    when = np.linspace(0, cost.total_seconds, len(path))
    thickness = points(float(np.clip(2700 / len(path), 0.33, 2.5)))
    pieces = list(np.stack([path[:-1], path[1:]], axis=1))
    way = LineCollection(pieces, array=when[1:], linewidths=thickness, cmap=TIME)
    way.set_clim(0.0, cost.total_seconds)
    colour_bar(axes, axes.add_collection(way), "time (s)")
    signs = [(end - 1, "o", 7) for end in plan.pass_ends[:-1]] + [(0, ">", 10), (-1, "s", 10)]
    for at, shape, size in signs:
        axes.plot(*path[at], shape, color=FOREGROUND, markersize=points(size), markeredgewidth=points(2.5))
    half = 1.05 * MM * plan.mask.aperture / 2
    axes.set(xlim=(-half, half), ylim=(-half, half))
    title = f"Way of the beam, {MM * cost.travel:.0f} mm; start ▸, end ■"
    style_axes(axes, title=title, across="x (mm)", up="y (mm)", equal=True)


def _draw_seconds(cost: PlanCost, axes: Axes) -> None:
    names, values = list(cost.seconds), list(cost.seconds.values())
    bars = axes.barh(names, values, color=[ACCENT if name == cost.limiting else PLAIN for name in names])
    texts = [f"{value:.3g} s" for value in values]
    axes.bar_label(bars, texts, padding=points(GAP), fontsize=points(TICK), color=FOREGROUND)
    _draw_limit(axes, cost.total_seconds)
    axes.set_xlim(0, 1.25 * max(cost.total_seconds, *values))
    axes.invert_yaxis()
    title = f"{cost.total_seconds:.4g} s in all (dotted), limited by the {cost.limiting}"
    style_axes(axes, title=title, across="seconds by itself")


def _draw_moves(plan: ScanPlan, axes: Axes) -> None:
    taken = plan.pace.move_times(plan.path)
    if plan.bias is not None:
        taken = np.maximum(taken, plan.pace.retune_times(plan.bias[plan.visit[:: plan.beam_count]]))
    period = 1e3 / plan.pulse_rate
    counts, edges = draw_histogram(axes, 1e3 * taken, 60, 1e-3 * period)
    _draw_limit(axes, period)
    low, high = min(float(edges[0]), period), max(float(edges[-1]), period)
    axes.set_yscale("log")
    axes.set(xlim=(low - 0.05 * (high - low), high + 0.05 * (high - low)), ylim=(0.7, 1.6 * counts.max()))
    style_axes(axes, title="Moving and tuning to a point; pulse period dotted", across="time (ms)", up="points")


def _draw_limit(axes: Axes, value: float) -> None:
    axes.axvline(value, color=FOREGROUND, linestyle=":", linewidth=points(1.5))
