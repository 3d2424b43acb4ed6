"""Drawing primitives of the raster renderer."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from steradian.drawing.style import BACKGROUND, FOREGROUND, GAP, LABEL, TICK, font
from steradian.drawing.ticks import Axis

Box = tuple[float, float, float, float]
"""Left, top, right and bottom in pixels."""
MARK = 5
"""Length in pixels of the lines that mark a place on an axis."""


@dataclass(frozen=True)
class ColourBar:
    """Colour bar (256, 3), first colour at the axis' first value; ``beyond``: values continue above its top."""

    colours: NDArray[np.uint8]
    axis: Axis
    beyond: bool = False


@dataclass
class Canvas:
    """Canvas of given width and height with drawing primitives, which records the box of each label."""

    width: int
    height: int
    labels: list[tuple[str, Box]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.image = Image.new("RGB", (self.width, self.height), BACKGROUND)
        self.strokes = ImageDraw.Draw(self.image)

    def write(
        self, x: float, y: float, text: str, size: int, colour: str, anchor: str, around: str | None = None
    ) -> Box:
        """Draw a horizontal label, record and return its box."""
        edge = {"stroke_width": 1, "stroke_fill": around} if around else {}
        self.strokes.text((x, y), text, colour, font(size), anchor=anchor, **edge)  # type: ignore[arg-type]
        box = self.strokes.textbbox((x, y), text, font(size), anchor=anchor)
        self.labels.append((text, box))
        return box

    def write_vertical(self, x: float, middle: float, text: str) -> None:
        """Draw a label from bottom to top, its left edge at ``x``."""
        width, height = round(font(LABEL).getlength(text)) + 2, line_height(LABEL)
        label = Image.new("RGB", (width, height), BACKGROUND)
        ImageDraw.Draw(label).text((1, 0), text, FOREGROUND, font(LABEL), anchor="la")
        top = min(max(0, round(middle - width / 2)), self.height - width)
        self.image.paste(label.transpose(Image.Transpose.ROTATE_90), (round(x), top))
        self.labels.append((text, (round(x), top, round(x) + height, top + width)))

    def put_axes(self, left: int, top: int, width: int, height: int, across: Axis, up: Axis) -> None:
        """Draw ticks and labels of the axes."""
        bottom, tips = top + height, [left - MARK - GAP]
        for place, text in across.marks(width):
            x = left + place
            self.strokes.line((x, bottom, x, bottom + MARK), FOREGROUND)
            self.write(x, bottom + MARK + GAP // 2, text, TICK, FOREGROUND, "ma")
        for place, text in up.marks(height, TICK):
            y = top + place
            self.strokes.line((left - MARK, y, left, y), FOREGROUND)
            tips.append(round(self.write(left - MARK - GAP // 2, y, text, TICK, FOREGROUND, "rm")[0]))
        below = bottom + MARK + GAP + line_height(TICK)
        self.write(left + width / 2, below, across.name, LABEL, FOREGROUND, "ma")
        if up.name:
            self.write_vertical(min(tips) - GAP - line_height(LABEL), top + height / 2, up.name)

    def draw_colour_bar(
        self, bar: ColourBar, left: int, top: int, width: int, height: int, right: int, label: list[str]
    ) -> None:
        """Draw a colour bar with its tick labels; the lines of its title end before ``right``."""
        ramp = np.repeat(bar.colours[:, None], width, axis=1)
        self.image.paste(Image.fromarray(ramp).resize((width, height), Image.Resampling.BOX), (left, top))
        if bar.beyond:
            tip = (left, top - 1, left + width - 1, top - 1, left + width / 2, top - width * 0.6)
            self.strokes.polygon(tip, tuple(int(c) for c in bar.colours[0]))
        edge = left + width
        for place, text in bar.axis.marks(height, TICK):
            y = top + place
            self.strokes.line((edge, y, edge + MARK, y), FOREGROUND)
            self.write(edge + MARK + GAP // 2, y, text, TICK, FOREGROUND, "lm")
        for number, text in enumerate(reversed(label)):
            self.write_vertical(right - 2 * GAP - (number + 1) * line_height(LABEL), top + height / 2, text)


def left_margin(up: Axis, height: int) -> int:
    """Return the width in pixels of the ticks and label of a vertical axis."""
    name = line_height(LABEL) + GAP if up.name else 0
    return round(2 * GAP + name + _widest(up, height) + GAP + MARK)


def right_margin(axis: Axis, height: int, lines: int) -> int:
    """Return the width in pixels of a colour bar's tick labels and of its title of some lines."""
    return round(MARK + GAP + _widest(axis, height) + GAP + lines * line_height(LABEL) + 2 * GAP)


def line_height(size: int) -> int:
    """Return the height in pixels of a line of text."""
    return size + 4


def wrapped(text: str, size: int, room: float) -> list[str]:
    """Return a text broken into lines that fit a width."""
    lines: list[str] = []
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and font(size).getlength(longer) <= room:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def _widest(axis: Axis, pixels: int) -> float:
    return max((font(TICK).getlength(text) for _, text in axis.marks(pixels, TICK)), default=0.0)
