"""Data classes that specify plots independently of the renderer.

Lengths of what is drawn are in pixels of the page; places are in the units of the plot's axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from steradian.drawing.style import ACCENT, FOREGROUND, PLAIN
from steradian.drawing.ticks import Axis, NamedRows

Floats: TypeAlias = NDArray[np.float64]
Shape = Literal["+", "o", "s", ">"]


@dataclass(frozen=True)
class Colours:
    """Colour scale of a plot: name of a colour map, values at its ends, and label."""

    name: str
    low: float
    high: float
    label: str

    @classmethod
    def spanning(cls, values: Floats, name: str, label: str) -> Colours:
        """Return the colour scale from minimum to maximum; a range below a thousandth counts as one colour."""
        low, high = float(values.min()), float(values.max())
        margin = 0.05 * high if high - low < 1e-3 * high else 0.0
        return cls(name, low - margin, high + margin, label)


@dataclass(frozen=True)
class Heatmap:
    """Heat map of values (rows, columns), first row at the top; ``smooth``: interpolated."""

    values: Floats
    colours: Colours
    smooth: bool = False


@dataclass(frozen=True)
class Scatter:
    """Scatter plot: discs at positions (n, 2), coloured by values (n,)."""

    places: Floats
    values: Floats
    colours: Colours
    diameter: float


@dataclass(frozen=True)
class ColouredPath:
    """Polyline through positions (n, 2), whose segments are coloured by values (n - 1,)."""

    places: Floats
    values: Floats
    colours: Colours
    width: float


@dataclass(frozen=True)
class Curve:
    """Polyline through positions (n, 2) in one colour."""

    places: Floats
    colour: str
    width: float = 1.3


@dataclass(frozen=True)
class VerticalLine:
    """Dotted vertical line over the full height of a plot."""

    x: float
    colour: str = FOREGROUND


@dataclass(frozen=True)
class Marker:
    """Marker symbol of some size at a position."""

    x: float
    y: float
    shape: Shape
    size: float
    colour: str = FOREGROUND
    width: float = 2.5


@dataclass(frozen=True)
class Histogram:
    """Histogram: counts (n,) between edges (n + 1,)."""

    edges: Floats
    counts: Floats
    colour: str = PLAIN


@dataclass(frozen=True)
class Bars:
    """Horizontal bar chart: a bar from zero to a value in each row, with a text at its end."""

    values: Sequence[float]
    texts: Sequence[str]
    colours: Sequence[str]


@dataclass(frozen=True)
class Annotation:
    """Text centred at a position, with an outline of another colour so that it is legible on any background."""

    x: float
    y: float
    text: str
    colour: str
    around: str


Part: TypeAlias = Heatmap | Scatter | ColouredPath | Curve | VerticalLine | Marker | Histogram | Bars | Annotation


@dataclass(frozen=True)
class Plot:
    """Plot: axes and layers, first ones lowest; the first value of ``up`` is at the top. ``equal``: equal scales."""

    title: str
    across: Axis
    up: Axis | NamedRows
    parts: Sequence[Part]
    equal: bool = False

    @property
    def colours(self) -> Colours | None:
        """Colour scale shown by the plot's colour bar."""
        return next((part.colours for part in self.parts if isinstance(part, Heatmap | Scatter | ColouredPath)), None)


@dataclass(frozen=True)
class Page:
    """Page layout: columns of plots with relative widths; ``width`` pixels wide and ``shape`` times as high."""

    title: str
    columns: Sequence[Sequence[Plot]]
    shares: Sequence[float]
    width: int
    shape: float

    @property
    def plots(self) -> list[Plot]:
        """All plots, column by column."""
        return [plot for column in self.columns for plot in column]


def poi_marker(x: float, y: float, around: str) -> tuple[Marker, Marker]:
    """Return the marker of a point of interest, which is visible on any background."""
    return Marker(x, y, "+", 22, around, 5), Marker(x, y, "+", 20, ACCENT)


def histogram(values: Floats, bins: int, margin: float) -> Histogram:
    """Return the histogram of values in ``bins`` equal bins from minimum − margin to maximum + margin."""
    low, high = float(values.min()) - margin, float(values.max()) + margin
    counts, edges = np.histogram(values, np.linspace(low, high, bins + 1))
    return Histogram(edges, counts.astype(float))
