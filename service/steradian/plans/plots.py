"""Summary figure of a scan plan."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from steradian.core.exceptions import InvalidInput
from steradian.drawing import display_dispatch
from steradian.drawing.plot_spec import (
    Bars,
    ColouredPath,
    Colours,
    Marker,
    Page,
    Part,
    Plot,
    Shape,
    VerticalLine,
    histogram,
)
from steradian.drawing.style import ACCENT, PLAIN, TIME
from steradian.drawing.ticks import Axis, LogAxis, NamedRows
from steradian.plans.files import write_json
from steradian.plans.plan import ScanPlan
from steradian.plans.preview import PlanCost, preview

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MM = 1e3
WIDTH, SHAPE = 1320, 0.55
"""Width of the page in pixels, and its height over it."""


@display_dispatch.plot.register(ScanPlan)
def _plot_plan(plan: ScanPlan, axes: Axes | None = None) -> Axes:
    from steradian.drawing.mpl_renderer import draw_into_axes
    from steradian.drawing.notebook import resolve_axes

    axes = resolve_axes(axes)
    draw_into_axes(path_plot(plan), axes)
    return axes


@display_dispatch.save.register(ScanPlan)
def _save_plan(plan: ScanPlan, path: Path) -> None:
    from steradian.drawing.mpl_style import PICTURES

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
    from steradian.drawing.mpl_renderer import save

    save(plan_figure(plan, cost, width=width), path)


def plan_figure(plan: ScanPlan, cost: PlanCost | None = None, *, width: int = WIDTH) -> Page:
    """Return the page specification of a plan's summary figure, as drawn by :func:`draw_plan`."""
    cost = cost or preview(plan)
    order = str(plan.order).replace("_", " ")
    title = f"Plan of {plan.mask.count:,} points at {plan.pulse_rate:g} Hz in the order {order!r}"
    return Page(title, [[path_plot(plan, cost)], [_seconds_plot(cost), _moves_plot(plan)]], (1.1, 1), width, SHAPE)


def path_plot(plan: ScanPlan, cost: PlanCost | None = None) -> Plot:
    """Return a plot of the beam's path, coloured by time."""
    cost = cost or preview(plan)
    points = MM * plan.path
    when = np.linspace(0, cost.total_seconds, len(points))
    thickness = float(np.clip(2700 / len(points), 0.33, 2.5))
    way = ColouredPath(points, when[1:], Colours(TIME, 0.0, cost.total_seconds, "time (s)"), thickness)
    signs: list[tuple[int, Shape, float]] = [(end - 1, "o", 7) for end in plan.pass_ends[:-1]]
    signs += [(0, ">", 10), (-1, "s", 10)]
    ends = [Marker(float(points[at, 0]), float(points[at, 1]), shape, size) for at, shape, size in signs]
    half = 1.05 * MM * plan.mask.aperture / 2
    title = f"Way of the beam, {MM * cost.travel:.0f} mm; start ▸, end ■"
    return Plot(title, Axis(-half, half, "x (mm)"), Axis(half, -half, "y (mm)"), [way, *ends], equal=True)


def _seconds_plot(cost: PlanCost) -> Plot:
    names, values = tuple(cost.seconds), tuple(cost.seconds.values())
    colours = [ACCENT if name == cost.limiting else PLAIN for name in names]
    parts: list[Part] = [
        VerticalLine(cost.total_seconds),
        Bars(values, [f"{value:.3g} s" for value in values], colours),
    ]
    title = f"{cost.total_seconds:.4g} s in all (dotted), limited by the {cost.limiting}"
    across = Axis(0, 1.25 * max(cost.total_seconds, *values), "seconds by itself")
    return Plot(title, across, NamedRows(names), parts)


def _moves_plot(plan: ScanPlan) -> Plot:
    taken = plan.pace.move_times(plan.path)
    if plan.bias is not None:
        taken = np.maximum(taken, plan.pace.retune_times(plan.bias[plan.visit[:: plan.beam_count]]))
    period = 1e3 / plan.pulse_rate
    steps = histogram(1e3 * taken, 60, 1e-3 * period)
    low, high = min(float(steps.edges[0]), period), max(float(steps.edges[-1]), period)
    across = Axis(low - 0.05 * (high - low), high + 0.05 * (high - low), "time (ms)")
    up = LogAxis(1.6 * float(steps.counts.max()), 0.7, "points")
    title = "Moving and tuning to a point; pulse period dotted"
    return Plot(title, across, up, [steps, VerticalLine(period)])
