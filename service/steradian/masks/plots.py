"""Summary figure of a mask."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from steradian.drawing import display_dispatch
from steradian.drawing.mpl_style import (
    PICTURES,
    colour_bar,
    colour_limits,
    draw_histogram,
    page,
    points,
    save,
    set_title,
    style_axes,
)
from steradian.drawing.style import ACCENT, BACKGROUND, FOREGROUND, PLACE, PLAIN, PRESSURE, SECONDARY, SHARE, TICK
from steradian.masks.io import write_mask
from steradian.masks.limited_view import limited_view
from steradian.masks.mask import Mask
from steradian.masks.metrics import evaluate_mask, nearest_neighbour_spacing, spacing_map
from steradian.masks.point_spread import PointSpread, point_spread

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MM = 1e3
WIDTH, SHAPE = 1320, 0.84
"""Width of the page in pixels, and its height over it."""
X_LABEL, Y_LABEL, DEPTH = "x (mm)", "y (mm)", "z, depth (mm)"
TILTS = (15, 30, 45, 60, 75)
"""Degrees of the lines in the limited view."""


def draw_mask(
    mask: Mask, path: Path, *, deepest: float | None = None, with_point_spread: bool = True, width: int = WIDTH
) -> None:
    """Draw a mask's summary figure into a picture file; the suffix determines the format.

    Parameters
    ----------
    mask
        The mask.
    path
        The file, for example ``mask.png``; written whole or not at all.
    deepest
        Depth in metres down to which the limited view is shown; ``None`` for twice the point of interest's.
    with_point_spread
        Whether to simulate and reconstruct a tiny ball at the point of interest (about a second).
    width
        Of the page in pixels.
    """
    save(mask_figure(mask, deepest=deepest, with_point_spread=with_point_spread, width=width), path)


def mask_figure(
    mask: Mask, *, deepest: float | None = None, with_point_spread: bool = True, width: int = WIDTH
) -> Figure:
    """Return a matplotlib figure of a mask's summary, as drawn by :func:`draw_mask`, without saving."""
    figure = page(width, SHAPE)
    cells = figure.subplots(2, 2)
    draw_points(mask, cells[0, 0])
    _draw_spacing(mask, cells[0, 1])
    _draw_view(mask, cells[1, 0], deepest)
    if with_point_spread and len(mask.points_of_interest) > 0:
        _draw_spread(point_spread(mask), cells[1, 1])
    else:
        _draw_shares(mask, cells[1, 1])
    set_title(figure, mask.title)
    return figure


@display_dispatch.plot.register(Mask)
def _plot_mask(mask: Mask, axes: Axes | None = None) -> Axes:
    from steradian.drawing.notebook import resolve_axes

    axes = resolve_axes(axes)
    draw_points(mask, axes)
    return axes


@display_dispatch.save.register(Mask)
def _save_mask(mask: Mask, path: Path) -> None:
    if path.suffix.lower() in PICTURES:
        draw_mask(mask, path)
    else:
        write_mask(mask, path)


def draw_points(mask: Mask, axes: Axes) -> None:
    """Draw the sensors, coloured by weight (area)."""
    cells = mask.weights * MM ** mask.positions.shape[1]
    area = points(float(np.clip(183 / np.sqrt(mask.count), 0.9, 9))) ** 2
    x, y = MM * mask.film_positions.T
    shown = axes.scatter(x, y, c=cells, s=area, linewidths=0, **colour_limits(cells, PLACE))
    half = MM * mask.aperture / 2
    axes.plot(*(half * np.array([[-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1]])), color=SECONDARY, linewidth=points(1.3))
    _mark_points_of_interest(mask, axes, 1)
    colour_bar(axes, shown, f"cell of a sensor ({'mm' if mask.is_line else 'mm²'})")
    axes.set(xlim=(-1.05 * half, 1.05 * half), ylim=(-1.05 * half, 1.05 * half))
    title = "Sensors, point of interest +" if len(mask.points_of_interest) else "Sensors"
    style_axes(axes, title=title, across=X_LABEL, up=Y_LABEL, equal=True)


def _draw_spacing(mask: Mask, axes: Axes) -> None:
    title = "Spacing: distance to the nearest sensor"
    half = MM * mask.aperture / 2
    if mask.is_line:
        x, spacing = MM * mask.positions[:, 0], 1e6 * nearest_neighbour_spacing(mask)
        margin = 0.05 * float(np.ptp(spacing) or spacing[0])
        axes.plot(x, spacing, "o-", color=PLAIN, linewidth=points(1.3), markersize=points(5))
        axes.set(xlim=(-half, half), ylim=(spacing.min() - margin, spacing.max() + margin))
        style_axes(axes, title=title, across=X_LABEL, up="spacing (µm)")
        return
    values = 1e6 * spacing_map(mask, 200).T
    extent = (-half, half, -half, half)
    shown = axes.imshow(values, origin="lower", extent=extent, **colour_limits(values, PLACE))
    colour_bar(axes, shown, "spacing (µm)")
    style_axes(axes, title=title, across=X_LABEL, up=Y_LABEL, equal=True)


def _draw_view(mask: Mask, axes: Axes, deepest: float | None = None) -> None:
    """Draw the visible fraction of edges in the plane through the point of interest."""
    depth = deepest or (2 * float(mask.points_of_interest[:, 2].max()) if mask.depth else mask.aperture / 2)
    half = MM * mask.aperture / 2
    view = limited_view(mask, depth)
    extent = (-half, half, MM * depth, 0.0)
    shown = axes.imshow(100 * view.share.T, extent=extent, aspect="auto", cmap=SHARE, vmin=0, vmax=100)
    colour_bar(axes, shown, "visible edge orientations (%)")
    first, last = (MM * end for end in view.ends)
    if first < last:
        for tilt in TILTS:  # limits of visibility, from the normals to the outermost sensors
            tip = (last - first) / 2 / np.tan(np.radians(tilt))
            places = [first, (first + last) / 2, last], [0.0, tip, 0.0]
            axes.plot(*places, color=BACKGROUND, linewidth=points(1.3))
        for end in (first, last):
            axes.axvline(end, color=BACKGROUND, linestyle=":", linewidth=points(1.5))
    _mark_points_of_interest(mask, axes, 2)
    _label_angles(axes, first, last, MM * depth, (MM * mask.points_of_interest[:, 2]).tolist())
    axes.set(xlim=(-half, half), ylim=(MM * depth, 0.0))
    style_axes(axes, title="Limited view: tilt of edges seen from both sides", across=X_LABEL, up=DEPTH)


def _label_angles(axes: Axes, first: float, last: float, deepest: float, taken: list[float]) -> None:
    """Write the viewing angles onto the depth axis without overlap."""
    from matplotlib.patheffects import withStroke

    for tilt in TILTS:
        depth = min(-first, last) / np.tan(np.radians(tilt))
        if 0.04 * deepest < depth < 0.96 * deepest and all(abs(depth - other) > 0.08 * deepest for other in taken):
            taken = [*taken, depth]
            around = [withStroke(linewidth=points(2), foreground=FOREGROUND)]
            look: dict[str, Any] = {"color": BACKGROUND, "fontsize": points(TICK), "path_effects": around}
            axes.text(0.0, depth, f"{tilt}°", ha="center", va="center", **look)


def _draw_spread(spread: PointSpread, axes: Axes) -> None:
    """Draw the point-spread function: the image of a tiny ball."""
    extent = (MM * spread.x[0], MM * spread.x[-1], MM * spread.z[-1], MM * spread.z[0])
    shown = axes.imshow(spread.section.T, extent=extent, cmap=PRESSURE, vmin=-0.2, vmax=1, interpolation="bilinear")
    colour_bar(axes, shown, "relative pressure")
    sizes = f"{1e6 * spread.lateral:.0f} µm wide, {1e6 * spread.axial:.0f} µm deep"
    title = f"A ball of {1e6 * spread.true_width:.0f} µm: {sizes}"
    style_axes(axes, title=title, across=X_LABEL, up=DEPTH, equal=True)


def _draw_shares(mask: Mask, axes: Axes) -> None:
    """Draw the uniformity of the sensors: in solid angle, or in spacing without a point of interest."""
    seen = evaluate_mask(mask)
    if seen.solid_angles is not None:
        values, name = 100 * seen.solid_angles / seen.solid_angles.mean(), "solid angle over its mean (%)"
        title = "Solid angle that each sensor covers"
    else:
        values, name = 1e6 * seen.spacing, "spacing (µm)"
        title = "How often each spacing occurs, no point of interest given"
    low, high = float(values.min()), float(values.max())
    counts, edges = draw_histogram(axes, values, 40, max(0.02 * high, 0.5 * (high - low) / 40))
    room = 0.05 * float(np.ptp(edges))
    axes.set(xlim=(edges[0] - room, edges[-1] + room), ylim=(0.0, 1.05 * counts.max()))
    style_axes(axes, title=title, across=name, up="sensors")


def _mark_points_of_interest(mask: Mask, axes: Axes, up: int) -> None:
    """Draw a cross at each point of interest, visible on any background."""
    for focus in MM * mask.points_of_interest:
        for size, width, colour in ((22, 5, BACKGROUND), (20, 2.5, ACCENT)):
            look: dict[str, Any] = {"markersize": points(size), "markeredgewidth": points(width)}
            axes.plot(focus[0], focus[up], "+", color=colour, **look)
