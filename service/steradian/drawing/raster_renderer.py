"""Fast raster renderer of plot specifications.

What lies inside of a plot's frame is drawn larger than it is and shrunk, which smooths its edges.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import singledispatchmethod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from steradian.core.atomic_files import atomic_write
from steradian.drawing.canvas import MARK, Box, Canvas, ColourBar, left_margin, line_height, right_margin, wrapped
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
from steradian.drawing.style import (
    BACKGROUND,
    BAR_SHARE,
    BAR_START,
    FOREGROUND,
    GAP,
    LABEL,
    LEAST,
    SECONDARY,
    TICK,
    TITLE,
    colours,
)
from steradian.drawing.ticks import Axis

SUPERSAMPLING = 3
"""How many times larger the inside of a plot is drawn."""
COLUMN_GAP = 84
"""Pixels on either side of a plot, if its labels need no more; so that frames above each other are as wide."""


@dataclass(frozen=True)
class RasterPage:
    """Rendered page: its pixels, and the text and box of each label."""

    image: Image.Image
    labels: tuple[tuple[str, Box], ...]

    def png(self) -> bytes:
        """Return the page encoded as PNG."""
        written = io.BytesIO()
        self.image.save(written, format="png", compress_level=1)
        return written.getvalue()

    def save(self, path: Path) -> None:
        """Write the page as a PNG file by an atomic write."""
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as file:
            file.write_bytes(self.png())


def render_page(page: Page) -> RasterPage:
    """Render a page specification into pixels."""
    wide = max(page.width, LEAST)
    pen = Canvas(wide, round(page.shape * wide))
    head = 2 * GAP + line_height(TITLE + 2)
    pen.write(wide / 2, 2 * GAP, page.title, TITLE + 2, FOREGROUND, "ma")
    edges = np.round(np.cumsum([0, *page.shares]) / sum(page.shares) * wide).astype(int)
    for left, right, column in zip(edges, edges[1:], page.columns, strict=False):
        rows = np.round(np.linspace(head, pen.height, len(column) + 1)).astype(int)
        for top, bottom, plot in zip(rows, rows[1:], column, strict=False):
            _put(pen, plot, (int(left), int(top), int(right), int(bottom)))
    if page.width == wide:
        return RasterPage(pen.image, tuple(pen.labels))
    scale = page.width / wide
    image = pen.image.resize((page.width, round(page.shape * page.width)), Image.Resampling.LANCZOS)
    labels = [(text, (a * scale, b * scale, c * scale, d * scale)) for text, (a, b, c, d) in pen.labels]
    return RasterPage(image, tuple(labels))


def _put(pen: Canvas, plot: Plot, cell: tuple[int, int, int, int]) -> None:
    """Draw a plot into a cell of the page, as large as its labels permit."""
    top = cell[1] + 2 * GAP + line_height(TITLE)
    height = cell[3] - top - (MARK + GAP + line_height(TICK) + line_height(LABEL) + 2 * GAP)
    before, share, label = max(COLUMN_GAP, left_margin(plot.up, height)), 1.0, list[str]()
    behind = 4 * GAP
    if (scale := plot.colours) is not None:
        values, share = Axis(scale.high, scale.low, scale.label), 1 + BAR_START + BAR_SHARE
        label = wrapped(scale.label, LABEL, height)
        behind = max(COLUMN_GAP, right_margin(values, height, len(label)))
    room = width = int((cell[2] - cell[0] - before - behind) / share)
    left = cell[0] + before
    if plot.equal and isinstance(plot.up, Axis):
        pixels = min(width / plot.across.length, height / plot.up.length)
        width, high = round(pixels * plot.across.length), round(pixels * plot.up.length)
        left, top, height = left + int(share * (room - width)) // 2, top + (height - high) // 2, high
    pen.write(left + width / 2, top - GAP - line_height(TITLE), plot.title, TITLE, FOREGROUND, "ma")
    inside = PlotArea(plot, width, height)
    pen.image.paste(inside.drawn(), (left, top))
    pen.strokes.rectangle((left, top, left + width, top + height), None, SECONDARY)
    pen.put_axes(left, top, width, height, plot.across, plot.up)
    for x, y, text, colour, around, anchor in inside.texts:
        pen.write(left + x, top + y, text, TICK, colour, anchor, around)
    if scale is not None:
        start, wide = left + width + round(BAR_START * width), round(BAR_SHARE * width)
        right = start + wide + right_margin(values, height, len(label))
        pen.draw_colour_bar(ColourBar(colours(scale.name)[::-1], values), start, top, wide, height, right, label)


class PlotArea:
    """Renderer of one plot area of a given size in pixels; texts are returned for the caller to draw."""

    def __init__(self, plot: Plot, width: int, height: int) -> None:
        self._plot, self._size = plot, (SUPERSAMPLING * width, SUPERSAMPLING * height)
        self._image = Image.new("RGB", self._size, BACKGROUND)
        self._strokes = ImageDraw.Draw(self._image)
        self.texts: list[tuple[float, float, str, str, str | None, str]] = []

    def drawn(self) -> Image.Image:
        """Render the layers of a plot in order; return pixels and texts."""
        for part in self._plot.parts:
            self._draw(part)
        return self._image.reduce(SUPERSAMPLING)

    def _x(self, value: float) -> float:
        return self._plot.across.share(value) * self._size[0]

    def _y(self, value: float) -> float:
        return self._plot.up.share(value) * self._size[1]

    def _places(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert positions (n, 2) on linear axes to pixels (n, 2)."""
        assert isinstance(self._plot.up, Axis)  # noqa: S101 - rows have bars
        first = np.array([self._plot.across.first, self._plot.up.first])
        last = np.array([self._plot.across.last, self._plot.up.last])
        found: NDArray[np.float64] = (places - first) / (last - first) * self._size
        return found

    @singledispatchmethod
    def _draw(self, part: Any) -> None:
        raise TypeError(part)

    @_draw.register
    def _(self, part: Heatmap) -> None:
        across, up = self._size[0] // SUPERSAMPLING, self._size[1] // SUPERSAMPLING
        how = Image.Resampling.BILINEAR if part.smooth else Image.Resampling.BOX
        values = Image.fromarray(part.values.astype(np.float32)).resize((across, up), how)
        image = Image.fromarray(apply_colour_map(np.asarray(values), part.colours))
        self._image.paste(image.resize(self._size, Image.Resampling.NEAREST))

    @_draw.register
    def _(self, part: Scatter) -> None:
        radius = max(0.5, SUPERSAMPLING * part.diameter / 2)
        shades = apply_colour_map(part.values, part.colours)
        for (x, y), colour in zip(self._places(part.places).tolist(), shades.tolist(), strict=True):
            self._strokes.ellipse((x - radius, y - radius, x + radius, y + radius), tuple(colour))

    @_draw.register
    def _(self, part: ColouredPath) -> None:
        width = max(1, round(SUPERSAMPLING * part.width))
        places = [tuple(place) for place in self._places(part.places).tolist()]
        shades = apply_colour_map(part.values, part.colours).tolist()
        for start, end, colour in zip(places, places[1:], shades, strict=False):
            self._strokes.line((start, end), tuple(colour), width)

    @_draw.register
    def _(self, part: Curve) -> None:
        places = [tuple(place) for place in self._places(part.places).tolist()]
        self._strokes.line(places, part.colour, round(SUPERSAMPLING * part.width), joint="curve")

    @_draw.register
    def _(self, part: VerticalLine) -> None:
        x, dot = self._x(part.x), 1.5 * SUPERSAMPLING
        for y in np.arange(0.0, self._size[1], 2.5 * dot).tolist():
            self._strokes.rectangle((x - dot / 2, y, x + dot / 2, y + dot), part.colour)

    @_draw.register
    def _(self, part: Marker) -> None:
        x, y = self._x(part.x), self._y(part.y)
        half, width = SUPERSAMPLING * part.size / 2, round(SUPERSAMPLING * part.width)
        box = (x - half, y - half, x + half, y + half)
        match part.shape:
            case "+":
                self._strokes.line((x - half, y, x + half, y), part.colour, width)
                self._strokes.line((x, y - half, x, y + half), part.colour, width)
            case "o":
                self._strokes.ellipse(box, part.colour)
            case "s":
                self._strokes.rectangle(box, part.colour)
            case ">":
                self._strokes.polygon((x - half, y - half, x - half, y + half, x + half, y), part.colour)

    @_draw.register
    def _(self, part: Histogram) -> None:
        for left, right, count in zip(part.edges, part.edges[1:], part.counts, strict=False):
            start, end, top, bottom = round(self._x(left)), round(self._x(right)), self._y(count), self._size[1]
            if count > 0 and top < bottom:
                self._strokes.rectangle((start, top, max(start, end - 1), bottom), part.colour)

    @_draw.register
    def _(self, part: Bars) -> None:
        thick = 0.4 * self._size[1] / len(part.values)
        for row, (value, text, colour) in enumerate(zip(part.values, part.texts, part.colours, strict=True)):
            x, y = self._x(value), self._y(row)
            self._strokes.rectangle((0, y - thick, x, y + thick), colour)
            self.texts.append((x / SUPERSAMPLING + GAP, y / SUPERSAMPLING, text, FOREGROUND, BACKGROUND, "lm"))

    @_draw.register
    def _(self, part: Annotation) -> None:
        x, y = self._x(part.x) / SUPERSAMPLING, self._y(part.y) / SUPERSAMPLING
        self.texts.append((x, y, part.text, part.colour, part.around, "mm"))


def apply_colour_map(values: NDArray[Any], scale: Colours) -> NDArray[np.uint8]:
    """Map values to colours (..., 3) by a colour map."""
    share = np.clip((values - scale.low) * (255 / (scale.high - scale.low)), 0, 255)
    found: NDArray[np.uint8] = colours(scale.name)[share.astype(np.uint8)]
    return found
