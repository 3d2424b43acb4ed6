"""A page of pictures of a plan: the way of the beam, and where the time goes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from steradian.drawing.page import colour_bar, dress, name_page, page, save
from steradian.drawing.style import ACCENT, INK, PLAIN, TICK, TIME
from steradian.plans.preview import Preview, preview

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from steradian.plans.plan import ScanPlan

MM = 1e3
WIDTH, SHAPE = 1320, 0.55
"""Width of the page in pixels, and its height over it."""


def draw_plan(plan: ScanPlan, path: Path, cost: Preview | None = None, *, width: int = WIDTH) -> None:
    """Draw a plan into a picture file; the ending of its name decides the format.

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
    save(plan_page(plan, cost, width=width), path)


def plan_page(plan: ScanPlan, cost: Preview | None = None, *, width: int = WIDTH) -> Figure:
    """Draw the same as :func:`draw_plan` into a figure that is not saved."""
    cost = cost or preview(plan)
    figure = page(width, SHAPE)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.1, 1))
    draw_way(figure.add_subplot(grid[:, 0]), plan, cost)
    _draw_seconds(figure.add_subplot(grid[0, 1]), cost)
    _draw_moves(figure.add_subplot(grid[1, 1]), plan)
    order = str(plan.order).replace("_", " ")
    name_page(figure, f"Plan of {plan.mask.count:,} points at {plan.pulse_rate:g} Hz in the order {order!r}")
    return figure


def draw_way(axes: Axes, plan: ScanPlan, cost: Preview | None = None) -> None:
    """Show the way of the beam, coloured by the time at which it passes."""
    from matplotlib.collections import LineCollection

    cost = cost or preview(plan)
    points = MM * plan.mask.film_positions[plan.visit]
    when = np.linspace(0, cost.total_seconds, len(points))
    pieces = np.stack([points[:-1], points[1:]], axis=1)
    thickness = float(np.clip(1600 / len(points), 0.2, 1.5))
    way = axes.add_collection(LineCollection(list(pieces), array=when[1:], cmap=TIME, linewidths=thickness))
    colour_bar(axes, way, "time (s)")
    for end in plan.passes[:-1]:
        axes.plot(*points[end - 1], "o", color=INK, markersize=4)
    axes.plot(*points[0], ">", *points[-1], "s", color=INK, markersize=6)
    half = 1.05 * MM * plan.mask.aperture / 2
    axes.set(xlim=(-half, half), ylim=(-half, half))
    title = f"Way of the beam, {MM * cost.travel:.0f} mm; start ▸, end ■"
    dress(axes, title=title, across="x (mm)", up="y (mm)", equal=True)


def _draw_seconds(axes: Axes, cost: Preview) -> None:
    names = list(cost.seconds)
    colours = [ACCENT if name == cost.limiting else PLAIN for name in names]
    bars = axes.barh(names, [cost.seconds[name] for name in names], color=colours)
    axes.bar_label(bars, fmt=" %.3g s", padding=2, fontsize=TICK * 0.6, color=INK)
    axes.axvline(cost.total_seconds, color=INK, linestyle=":", linewidth=1, zorder=0)
    axes.invert_yaxis()
    axes.set_xlim(0, 1.25 * max(cost.total_seconds, *cost.seconds.values()))
    title = f"{cost.total_seconds:.4g} s in all (dotted), limited by the {cost.limiting}"
    dress(axes, title=title, across="seconds by itself")


def _draw_moves(axes: Axes, plan: ScanPlan) -> None:
    taken = plan.pace.moving(plan.mask.film_positions[plan.visit])
    if plan.bias is not None:
        taken = np.maximum(taken, plan.pace.retuning(plan.bias[plan.visit]))
    axes.hist(1e3 * taken, bins=60, color=PLAIN)
    axes.axvline(1e3 / plan.pulse_rate, color=INK, linestyle=":", linewidth=1)
    axes.set_yscale("log")
    dress(axes, title="Moving and tuning to a point; pulse period dotted", across="time (ms)", up="points")
