"""Matplotlib renderer of plot specifications."""

from __future__ import annotations

from functools import singledispatch
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from steradian.drawing import mpl_style as pages
from steradian.drawing.mpl_style import colour_bar, points, set_title, style_axes
from steradian.drawing.plot_spec import (
    Annotation,
    Bars,
    ColouredPath,
    Colours,
    Curve,
    Heatmap,
    Histogram,
    Marker,
    Page,
    Plot,
    Scatter,
    VerticalLine,
)
from steradian.drawing.raster_renderer import render_page
from steradian.drawing.style import FOREGROUND, GAP, TICK
from steradian.drawing.ticks import Axis, LogAxis

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def save(page: Page, path: Path) -> None:
    """Write a page specification into a file by an atomic write; the suffix determines the format.

    Raises
    ------
    InvalidInput
        When it is of no format of pictures.
    """
    if path.suffix.lower() in ("", ".png"):
        render_page(page).save(path)
    else:
        pages.save(to_figure(page), path)


def to_figure(page: Page) -> Figure:
    """Return a matplotlib figure of a page specification, without saving."""
    figure = pages.page(page.width, page.shape)
    grid = figure.add_gridspec(1, len(page.columns), width_ratios=page.shares)
    for number, column in enumerate(page.columns):
        cells = grid[0, number].subgridspec(len(column), 1)
        for row, plot in enumerate(column):
            draw_into_axes(plot, figure.add_subplot(cells[row, 0]))
    set_title(figure, page.title)
    return figure


def draw_into_axes(plot: Plot, axes: Axes) -> None:
    """Draw a plot specification into matplotlib axes."""
    if isinstance(plot.up, Axis):
        axes.set_yscale("log" if isinstance(plot.up, LogAxis) else "linear")
        axes.set_ylim(plot.up.last, plot.up.first)
    else:
        axes.set_yticks(range(len(plot.up.names)), plot.up.names)
        axes.set_ylim(len(plot.up.names) - 0.5, -0.5)
    axes.set_xlim(plot.across.first, plot.across.last)
    for part in plot.parts:
        drawn = _draw(part, axes)
        if isinstance(part, Heatmap | Scatter | ColouredPath):
            colour_bar(axes, drawn, part.colours.label)
    style_axes(axes, title=plot.title, across=plot.across.name, up=plot.up.name, equal=plot.equal)


@singledispatch
def _draw(part: Any, axes: Axes) -> Any:
    raise TypeError(part)


@_draw.register(Heatmap)
def _(part: Heatmap, axes: Axes) -> Any:
    extent = (*axes.get_xlim(), *axes.get_ylim())
    how = "bilinear" if part.smooth else None
    return axes.imshow(part.values, extent=extent, aspect="auto", interpolation=how, **_mapped(part.colours))


@_draw.register(Scatter)
def _(part: Scatter, axes: Axes) -> Any:
    area = points(part.diameter) ** 2
    x, y = part.places.T
    return axes.scatter(x, y, c=part.values, s=area, linewidths=0, **_mapped(part.colours))


@_draw.register(ColouredPath)
def _(part: ColouredPath, axes: Axes) -> Any:
    from matplotlib.collections import LineCollection

    pieces = list(np.stack([part.places[:-1], part.places[1:]], axis=1))
    way = LineCollection(pieces, array=part.values, linewidths=points(part.width), cmap=part.colours.name)
    way.set_clim(part.colours.low, part.colours.high)
    return axes.add_collection(way)


@_draw.register(Curve)
def _(part: Curve, axes: Axes) -> None:
    axes.plot(*part.places.T, color=part.colour, linewidth=points(part.width))


@_draw.register(VerticalLine)
def _(part: VerticalLine, axes: Axes) -> None:
    axes.axvline(part.x, color=part.colour, linestyle=":", linewidth=points(1.5))


@_draw.register(Marker)
def _(part: Marker, axes: Axes) -> None:
    size, width = points(part.size), points(part.width)
    axes.plot(part.x, part.y, part.shape, color=part.colour, markersize=size, markeredgewidth=width)


@_draw.register(Histogram)
def _(part: Histogram, axes: Axes) -> None:
    axes.stairs(part.counts, part.edges, fill=True, color=part.colour)


@_draw.register(Bars)
def _(part: Bars, axes: Axes) -> None:
    bars = axes.barh(range(len(part.values)), part.values, color=part.colours)
    axes.bar_label(bars, part.texts, padding=points(GAP), fontsize=points(TICK), color=FOREGROUND)


@_draw.register(Annotation)
def _(part: Annotation, axes: Axes) -> None:
    from matplotlib.patheffects import withStroke

    around = [withStroke(linewidth=points(2), foreground=part.around)]
    look: dict[str, Any] = {"color": part.colour, "fontsize": points(TICK), "path_effects": around}
    axes.text(part.x, part.y, part.text, ha="center", va="center", **look)


def _mapped(colours: Colours) -> dict[str, Any]:
    return {"cmap": colours.name, "vmin": colours.low, "vmax": colours.high}
