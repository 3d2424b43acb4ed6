"""A page of pictures of a plan: the way of the beam, and where the time goes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from steradian.plans.plan import ScanPlan
from steradian.plans.preview import Preview, moving_seconds, preview, tuning_seconds

RESOLUTION = 120
MM = 1e3


def draw_plan(plan: ScanPlan, path: Path, cost: Preview | None = None) -> None:
    """Draw a plan into a picture file; the ending of its name decides the format.

    Parameters
    ----------
    plan
        The plan.
    path
        The file, for example ``plan.png``; written whole or not at all.
    cost
        Its preview, if there is one already.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    cost = cost or preview(plan)
    figure = Figure(figsize=(11, 9), dpi=RESOLUTION, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, height_ratios=(2, 1))
    _draw_way(figure, figure.add_subplot(grid[0, :]), plan, cost)
    _draw_seconds(figure.add_subplot(grid[1, 0]), cost)
    _draw_moves(figure.add_subplot(grid[1, 1]), plan)
    figure.suptitle(f"{plan.mask.count:,} points at {plan.pulse_rate:g} Hz, order {plan.order} — {plan.id}")
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(path.name + ".new")
    figure.savefig(draft, format=path.suffix.lstrip(".") or "png")
    draft.replace(path)


def _draw_way(figure: Any, axes: Any, plan: ScanPlan, cost: Preview) -> None:
    from matplotlib.collections import LineCollection

    points = MM * plan.mask.film_positions[plan.visit]
    when = np.linspace(0, cost.total_seconds, len(points))
    pieces = np.stack([points[:-1], points[1:]], axis=1)
    width = float(np.clip(1600 / len(points), 0.2, 1.5))
    way = axes.add_collection(LineCollection(list(pieces), array=when[1:], cmap="turbo", linewidths=width))
    figure.colorbar(way, ax=axes, label="time (s)")
    for end in plan.passes[:-1]:
        axes.plot(*points[end - 1], "ko", markersize=4)
    axes.plot(*points[0], "k>", *points[-1], "ks", markersize=6)
    half = 1.05 * MM * plan.mask.aperture / 2
    title = f"Way of the beam, {MM * cost.travel:.0f} mm; start ▸, end ■"
    axes.set(title=title, xlabel="x (mm)", ylabel="y (mm)", aspect="equal", xlim=(-half, half), ylim=(-half, half))


def _draw_seconds(axes: Any, cost: Preview) -> None:
    names = list(cost.seconds)
    colours = ["crimson" if name == cost.limiting else "steelblue" for name in names]
    bars = axes.barh(names, [cost.seconds[name] for name in names], color=colours)
    axes.bar_label(bars, fmt=" %.3g s", padding=2)
    axes.axvline(cost.total_seconds, color="black", linestyle=":")
    axes.invert_yaxis()
    axes.set(
        title=f"{cost.total_seconds:.4g} s in all (dotted), limited by the {cost.limiting}",
        xlabel="seconds by itself",
        xlim=(0, 1.2 * max(cost.total_seconds, *cost.seconds.values())),
    )


def _draw_moves(axes: Any, plan: ScanPlan) -> None:
    taken = 1e3 * (moving_seconds(plan) + tuning_seconds(plan))
    axes.hist(taken, bins=60, color="steelblue")
    axes.axvline(1e3 / plan.pulse_rate, color="black", linestyle=":")
    axes.set(title="Moving and tuning a point; pulse period dotted", xlabel="ms", ylabel="points", yscale="log")
