"""Summary figure of a mask."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from steradian.drawing import display_dispatch
from steradian.drawing.plot_spec import (
    Annotation,
    Colours,
    Curve,
    Heatmap,
    Marker,
    Page,
    Part,
    Plot,
    Scatter,
    VerticalLine,
    histogram,
    poi_marker,
)
from steradian.drawing.style import BACKGROUND, FOREGROUND, PLACE, PLAIN, PRESSURE, SECONDARY, SHARE
from steradian.drawing.ticks import Axis
from steradian.masks.io import write_mask
from steradian.masks.limited_view import limited_view
from steradian.masks.mask import Mask
from steradian.masks.metrics import evaluate_mask, nearest_neighbour_spacing, spacing_map
from steradian.masks.point_spread import PointSpread, point_spread

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
    from steradian.drawing.mpl_renderer import save

    save(mask_figure(mask, deepest=deepest, with_point_spread=with_point_spread, width=width), path)


def mask_figure(
    mask: Mask, *, deepest: float | None = None, with_point_spread: bool = True, width: int = WIDTH
) -> Page:
    """Return the page specification of a mask's summary figure, as drawn by :func:`draw_mask`."""
    simulated = with_point_spread and len(mask.points_of_interest) > 0
    last = _spread_plot(point_spread(mask)) if simulated else _shares_plot(mask)
    columns = [[points_plot(mask), _view_plot(mask, deepest)], [_spacing_plot(mask), last]]
    return Page(mask.title, columns, (1, 1), width, SHAPE)


@display_dispatch.plot.register(Mask)
def _plot_mask(mask: Mask, axes: Axes | None = None) -> Axes:
    from steradian.drawing.mpl_renderer import draw_into_axes
    from steradian.drawing.notebook import resolve_axes

    axes = resolve_axes(axes)
    draw_into_axes(points_plot(mask), axes)
    return axes


@display_dispatch.save.register(Mask)
def _save_mask(mask: Mask, path: Path) -> None:
    from steradian.drawing.mpl_style import PICTURES

    if path.suffix.lower() in PICTURES:
        draw_mask(mask, path)
    else:
        write_mask(mask, path)


def points_plot(mask: Mask) -> Plot:
    """Return a scatter plot of the sensors, coloured by weight (area)."""
    cells = mask.weights * MM ** mask.positions.shape[1]
    colours = Colours.spanning(cells, PLACE, f"cell of a sensor ({'mm' if mask.is_line else 'mm²'})")
    diameter = float(np.clip(183 / np.sqrt(mask.count), 0.9, 9))
    half = MM * mask.aperture / 2
    corners = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
    parts = [
        Scatter(MM * mask.film_positions, cells, colours, diameter),
        Curve(corners, SECONDARY),
        *_poi_markers(mask, 1),
    ]
    title = "Sensors, point of interest +" if len(mask.points_of_interest) else "Sensors"
    return Plot(
        title, Axis(-1.05 * half, 1.05 * half, X_LABEL), Axis(1.05 * half, -1.05 * half, Y_LABEL), parts, equal=True
    )


def _spacing_plot(mask: Mask) -> Plot:
    title = "Spacing: distance to the nearest sensor"
    half = MM * mask.aperture / 2
    if mask.is_line:
        places = np.stack([MM * mask.positions[:, 0], 1e6 * nearest_neighbour_spacing(mask)], axis=1)
        margin = 0.05 * float(np.ptp(places[:, 1]) or places[0, 1])
        up = Axis(float(places[:, 1].max()) + margin, float(places[:, 1].min()) - margin, "spacing (µm)")
        dots = [Marker(x, y, "o", 5, PLAIN) for x, y in places.tolist()]
        return Plot(title, Axis(-half, half, X_LABEL), up, [Curve(places, PLAIN), *dots])
    values = 1e6 * spacing_map(mask, 200).T[::-1]
    field = Heatmap(values, Colours.spanning(values, PLACE, "spacing (µm)"))
    return Plot(title, Axis(-half, half, X_LABEL), Axis(half, -half, Y_LABEL), [field], equal=True)


def _view_plot(mask: Mask, deepest: float | None = None) -> Plot:
    """Return a plot of the visible fraction of edges in the plane through the point of interest."""
    depth = deepest or (2 * float(mask.points_of_interest[:, 2].max()) if mask.depth else mask.aperture / 2)
    half = MM * mask.aperture / 2
    view = limited_view(mask, depth)
    field = Heatmap(100 * view.share.T, Colours(SHARE, 0, 100, "visible edge orientations (%)"))
    first, last = (MM * end for end in view.ends)
    lines: list[Curve | VerticalLine] = []
    if first < last:
        lines = [*_visibility_limits(first, last), VerticalLine(first, BACKGROUND), VerticalLine(last, BACKGROUND)]
    taken = (MM * mask.points_of_interest[:, 2]).tolist()
    title = "Limited view: tilt of edges seen from both sides"
    parts = [field, *lines, *_poi_markers(mask, 2), *_label_angles(first, last, MM * depth, taken)]
    return Plot(title, Axis(-half, half, X_LABEL), Axis(0.0, MM * depth, DEPTH), parts)


def _visibility_limits(first: float, last: float) -> list[Curve]:
    """Return depth limits of the visibility of edges by tilt, from the normals to the outermost sensors."""
    middle, half = (first + last) / 2, (last - first) / 2
    tents = [[[first, 0.0], [middle, half / np.tan(np.radians(tilt))], [last, 0.0]] for tilt in TILTS]
    return [Curve(np.array(tent), BACKGROUND) for tent in tents]


def _label_angles(first: float, last: float, deepest: float, taken: list[float]) -> list[Annotation]:
    """Return text labels of the viewing angles, placed on the depth axis without overlap."""
    found = []
    for tilt in TILTS:
        depth = min(-first, last) / np.tan(np.radians(tilt))
        if 0.04 * deepest < depth < 0.96 * deepest and all(abs(depth - other) > 0.08 * deepest for other in taken):
            taken = [*taken, depth]
            found.append(Annotation(0.0, depth, f"{tilt}°", BACKGROUND, FOREGROUND))
    return found


def _spread_plot(spread: PointSpread) -> Plot:
    """Return a plot of the point-spread function: the image of a tiny ball."""
    field = Heatmap(spread.section.T, Colours(PRESSURE, -0.2, 1, "relative pressure"), smooth=True)
    sizes = f"{1e6 * spread.lateral:.0f} µm wide, {1e6 * spread.axial:.0f} µm deep"
    across = Axis(MM * float(spread.x[0]), MM * float(spread.x[-1]), X_LABEL)
    up = Axis(MM * float(spread.z[0]), MM * float(spread.z[-1]), DEPTH)
    return Plot(f"A ball of {1e6 * spread.true_width:.0f} µm: {sizes}", across, up, [field], equal=True)


def _shares_plot(mask: Mask) -> Plot:
    """Return a plot of the uniformity of the sensors: in solid angle, or in spacing without a point of interest."""
    seen = evaluate_mask(mask)
    if seen.solid_angles is not None:
        values, name = 100 * seen.solid_angles / seen.solid_angles.mean(), "solid angle over its mean (%)"
        title = "Solid angle that each sensor covers"
    else:
        values, name = 1e6 * seen.spacing, "spacing (µm)"
        title = "How often each spacing occurs, no point of interest given"
    low, high = float(values.min()), float(values.max())
    steps = histogram(values, 40, max(0.02 * high, 0.5 * (high - low) / 40))
    room = 0.05 * float(np.ptp(steps.edges))
    across = Axis(float(steps.edges[0]) - room, float(steps.edges[-1]) + room, name)
    return Plot(title, across, Axis(1.05 * float(steps.counts.max()), 0.0, "sensors"), [steps])


def _poi_markers(mask: Mask, up: int) -> list[Part]:
    return [
        sign
        for focus in mask.points_of_interest
        for sign in poi_marker(MM * float(focus[0]), MM * float(focus[up]), BACKGROUND)
    ]
