"""A page of pictures of a mask: where it senses, how densely, what it can see and how sharply."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from steradian.drawing.page import colour_bar, dress, name_page, note, page, panels, save
from steradian.drawing.style import ACCENT, PAPER, PLACE, PLAIN, PRESSURE, QUIET, SHARE, TICK
from steradian.masks.limited_view import limited_view
from steradian.masks.point_spread import PointSpread, point_spread
from steradian.masks.promises import promises, spacing_map

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from steradian.masks.mask import Mask

MM = 1e3
WIDTH, SHAPE = 1320, 0.84
"""Width of the page in pixels, and its height over it."""
ACROSS, UP, DEPTH = "x (mm)", "y (mm)", "z, depth (mm)"


def draw_mask(
    mask: Mask, path: Path, *, deepest: float | None = None, with_point_spread: bool = True, width: int = WIDTH
) -> None:
    """Draw a mask into a picture file; the ending of its name decides the format.

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
    save(mask_page(mask, deepest=deepest, with_point_spread=with_point_spread, width=width), path)


def mask_page(
    mask: Mask, *, deepest: float | None = None, with_point_spread: bool = True, width: int = WIDTH
) -> Figure:
    """Draw the same as :func:`draw_mask` into a figure that is not saved."""
    figure = page(width, SHAPE, laid_out=False)
    axes = panels(figure, 2, 2)
    draw_points(axes[0, 0], mask)
    _draw_spacing(axes[0, 1], mask)
    draw_view(axes[1, 0], mask, deepest)
    if with_point_spread and len(mask.points_of_interest):
        draw_spread(axes[1, 1], point_spread(mask))
    else:
        _draw_shares(axes[1, 1], mask)
    name_page(figure, title_of(mask))
    return figure


def title_of(mask: Mask) -> str:
    """Describe a mask in a line: arrangement, points, aperture, point of interest."""
    name = str(mask.arrangement.get("arrangement", "mask")).capitalize()
    parts = [f"{name} mask, {mask.count:,} points over {MM * mask.aperture:.4g} mm"]
    points = mask.points_of_interest
    if len(points) == 1:
        parts.append(f"point of interest {MM * points[0, 2]:.4g} mm deep")
    elif len(points):
        parts.append(f"{len(points)} points of interest")
    return ", ".join(parts)


def draw_points(axes: Axes, mask: Mask, *, bar: bool = True) -> None:
    """Show the sensors, coloured by the area each stands for."""
    x, y = MM * mask.film_positions.T
    size = float(np.clip(12_000 / mask.count, 0.3, 30))
    cells = mask.weights * MM ** mask.positions.shape[1]
    shown = axes.scatter(x, y, c=cells, s=size, cmap=PLACE, linewidths=0, **_span(cells))
    if bar:
        colour_bar(axes, shown, f"cell of a sensor ({'mm' if mask.is_line else 'mm²'})")
    _mark_points(axes, mask, 1)
    half = 1.05 * MM * mask.aperture / 2
    axes.set(xlim=(-half, half), ylim=(-half, half))
    title = "Sensors, point of interest +" if len(mask.points_of_interest) else "Sensors"
    dress(axes, title=title, across=ACROSS, up=UP, equal=True)


def _draw_spacing(axes: Axes, mask: Mask) -> None:
    title = "Spacing: distance to the nearest sensor"
    if mask.is_line:
        axes.plot(MM * mask.positions[:, 0], 1e6 * promises(mask).spacing, ".-", color=PLAIN)
        dress(axes, title=title, across=ACROSS, up="spacing (µm)")
        return
    half = MM * mask.aperture / 2
    values = 1e6 * spacing_map(mask).T
    shown = axes.imshow(values, origin="lower", extent=(-half, half, -half, half), cmap=PLACE, **_span(values))
    colour_bar(axes, shown, "spacing (µm)")
    dress(axes, title=title, across=ACROSS, up=UP, equal=True)


def draw_view(axes: Axes, mask: Mask, deepest: float | None = None, *, bar: bool = True) -> None:
    """Show which share of edges is visible in the plane through the point of interest."""
    depth = deepest or (2 * float(mask.points_of_interest[:, 2].max()) if mask.depth else mask.aperture / 2)
    view = limited_view(mask, depth)
    half = MM * mask.aperture / 2
    shown = axes.imshow(
        100 * view.share.T, extent=(-half, half, MM * depth, 0), aspect="auto", cmap=SHARE, vmin=0, vmax=100
    )
    if bar:
        colour_bar(axes, shown, "visible edge orientations (%)")
    angle = np.degrees(np.minimum(view.steepest_left, view.steepest_right))
    levels = [15, 30, 45, 60, 75]
    lines = axes.contour(MM * view.x, MM * view.z, angle.T, levels=levels, colors=PAPER, linewidths=0.8)
    taken = [float(focus[2]) for focus in mask.points_of_interest]
    places = _label_places(view.x, view.z, angle, levels, taken)
    if bar and places:
        axes.clabel(lines, fmt="%d°", fontsize=TICK * 0.6, manual=places)
    for place in mask.film_positions[:, 0].min(), mask.film_positions[:, 0].max():
        axes.axvline(MM * place, color=PAPER, linestyle=":", linewidth=0.8)
    _mark_points(axes, mask, 2)
    dress(axes, title="Limited view: tilt of edges seen from both sides", across=ACROSS, up=DEPTH)


def _label_places(
    x: NDArray[np.float64],
    z: NDArray[np.float64],
    angle: NDArray[np.float64],
    levels: list[int],
    taken: list[float],
) -> list[tuple[float, float]]:
    """Where the contours cross the middle, at depths apart from each other and from those ``taken``."""
    middle, found = len(x) // 2, []
    for level in levels:
        crossing = np.flatnonzero((angle[middle, :-1] >= level) & (angle[middle, 1:] < level))
        depth = float(z[crossing[0]]) if len(crossing) else 0.0
        if depth and all(abs(depth - other) > 0.08 * z[-1] for other in taken):
            taken = [*taken, depth]
            found.append((MM * float(x[middle]), MM * depth))
    return found


def draw_spread(axes: Axes, spread: PointSpread, *, bar: bool = True) -> None:
    """Show the image of a tiny ball."""
    extent = (MM * spread.x[0], MM * spread.x[-1], MM * spread.z[-1], MM * spread.z[0])
    shown = axes.imshow(spread.section.T, extent=extent, cmap=PRESSURE, vmin=-0.2, vmax=1, interpolation="bilinear")
    if bar:
        colour_bar(axes, shown, "relative pressure")
    sizes = f"{1e6 * spread.lateral:.0f} µm wide, {1e6 * spread.axial:.0f} µm deep"
    dress(axes, title=f"A ball of {1e6 * spread.true_width:.0f} µm: {sizes}", across=ACROSS, up=DEPTH, equal=True)


def _draw_shares(axes: Axes, mask: Mask) -> None:
    """Show how even the sensors are: in solid angle, or in spacing where there is no point of interest."""
    seen = promises(mask)
    if seen.solid_angles is not None:
        values, name = 100 * seen.solid_angles / seen.solid_angles.mean(), "solid angle over its mean (%)"
        title = "Solid angle that each sensor covers"
    else:
        values, name = 1e6 * seen.spacing, "spacing (µm)"
        title = "How often each spacing occurs"
    low, high = float(values.min()), float(values.max())
    margin = max(0.02 * high, 0.5 * (high - low) / 40)
    axes.stairs(*np.histogram(values, np.linspace(low - margin, high + margin, 41)), fill=True, color=PLAIN)
    dress(axes, title=title, across=name, up="sensors")
    if seen.solid_angles is None:
        note(axes, 0.98, 0.96, "no point of interest given", ha="right", va="top")


def _span(values: NDArray[np.float64]) -> dict[str, Any]:
    """Limits of a colour scale that shows no rounding: what varies by less than a thousandth is of one colour."""
    low, high = float(values.min()), float(values.max())
    margin = 0.05 * high if high - low < 1e-3 * high else 0.0
    return {"vmin": low - margin, "vmax": high + margin}


def _mark_points(axes: Axes, mask: Mask, up: int) -> None:
    for focus in mask.points_of_interest:
        axes.plot(MM * focus[0], MM * focus[up], "+", color=PAPER, markersize=13, markeredgewidth=3)
        axes.plot(MM * focus[0], MM * focus[up], "+", color=ACCENT, markersize=12, markeredgewidth=1.5)
    if up == 1:
        from matplotlib.patches import Rectangle

        half = MM * mask.aperture / 2
        axes.add_patch(Rectangle((-half, -half), 2 * half, 2 * half, fill=False, edgecolor=QUIET, linewidth=0.8))
