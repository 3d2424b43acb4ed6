"""A sheet with one image, its axes, a bar of colours and a scale bar, drawn straight into pixels.

Every reconstruction draws several, and a plotting library takes longer over them than the reconstruction needs for
the volume. Margins follow from the labels, which therefore never leave the sheet nor meet each other.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from steradian.drafts import draft
from steradian.drawing import style
from steradian.drawing.style import GAP, INK, LABEL, PAPER, QUIET, TICK, TITLE, font
from steradian.drawing.ticks import MOST, ticks

Box = tuple[float, float, float, float]
"""Left, top, right and bottom in pixels."""
SHORT_SIDE = 160
"""Room in pixels that either side of the image has at least, however thin the image is."""
MARK, BAR_WIDTH = 5, 18
ROUND_LENGTHS = (0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50)


@dataclass(frozen=True)
class Axis:
    """An axis of the image: the values at its first and last edge, in the direction of drawing, and its name."""

    first: float
    last: float
    name: str

    @property
    def length(self) -> float:
        """Distance of its ends."""
        return abs(self.last - self.first)

    def place(self, value: float, pixels: int) -> float:
        """Where a value lies along ``pixels``."""
        return (value - self.first) / (self.last - self.first) * pixels

    def marks(self, pixels: int, room: int | None = None) -> list[tuple[float, str]]:
        """Places in pixels and texts of the marks; as many as have room side by side, or of ``room`` pixels each."""
        for most in range(MOST, 0, -1):
            values = ticks(min(self.first, self.last), max(self.first, self.last), most)
            found = sorted((self.place(value, pixels), style.number(value)) for value in values)
            sizes = [room or font(TICK).getlength(text) for _, text in found]
            steps = zip(found, found[1:], sizes, sizes[1:], strict=False)
            if all(b[0] - a[0] >= (left + right) / 2 + GAP for a, b, left, right in steps):
                return found
        return []


@dataclass(frozen=True)
class Bar:
    """A bar of colours (256, 3), first colour at the axis' first value; ``beyond``: values go on past its top."""

    colours: NDArray[np.uint8]
    axis: Axis
    beyond: bool = False


@dataclass(frozen=True)
class Drawn:
    """What was drawn where.

    Attributes
    ----------
    size
        Width and height of the sheet in pixels.
    frame
        Where the image lies.
    labels
        Text and box of each label.
    highest
        Value at the bright end of the scale.
    """

    size: tuple[int, int]
    frame: Box
    labels: tuple[tuple[str, Box], ...]
    highest: float


@dataclass
class Sheet:
    """An image of (height, width, 3) pixels enlarged to ``width`` × ``height``, with what belongs around it.

    Parameters
    ----------
    scale_bar
        Length in the unit of ``across`` (mm): ``None`` a round one, 0 none.
    """

    pixels: NDArray[np.uint8]
    width: int
    height: int
    title: str
    remark: str
    across: Axis
    up: Axis
    bar: Bar
    scale_bar: float | None = None
    labels: list[tuple[str, Box]] = field(default_factory=list)

    def save(self, path: Path) -> Drawn:
        """Draw into a PNG, under a temporary name first."""
        drawn = self.draw()
        with draft(path) as file:
            self._image.save(file, format="png", compress_level=1)
        return drawn

    def draw(self) -> Drawn:
        """Lay out and draw."""
        room_x, room_y = max(self.width, SHORT_SIDE), max(self.height, SHORT_SIDE)
        ups, line = self.up.marks(self.height, TICK), _line(LABEL)
        widest = max((font(TICK).getlength(text) for _, text in ups), default=0.0)
        left_margin = round(2 * GAP + line + GAP + widest + GAP + MARK)
        # what is narrower than its room stands in its middle, and the left margin shrinks by what is free there
        left = max(left_margin, 2 * GAP) + (room_x - self.width) // 2
        bar_left = left + self.width + 4 * GAP
        bar_height = max(round(0.8 * self.height), SHORT_SIDE)
        bars = self.bar.axis.marks(bar_height, TICK)
        bar_label = _wrapped(self.bar.axis.name, LABEL, max(room_y, bar_height))
        bar_text = max((font(TICK).getlength(text) for _, text in bars), default=0.0)
        right = round(bar_left + BAR_WIDTH + MARK + GAP + bar_text + GAP + len(bar_label) * line + 2 * GAP)
        heading = [(text, TITLE, INK) for text in _wrapped(self.title, TITLE, right - 4 * GAP)]
        heading += [(text, TICK, QUIET) for text in _wrapped(self.remark, TICK, right - 4 * GAP)]
        start = min(left, max(2 * GAP, right - 2 * GAP - round(max(_width(t, s) for t, s, _ in heading))))
        top = 2 * GAP + sum(_line(size) for _, size, _ in heading) + 2 * GAP + (room_y - self.height) // 2
        foot = MARK + GAP + _line(TICK) + line + 2 * GAP
        bottom = max(top + self.height + foot, top + (self.height + bar_height) // 2 + 2 * GAP)
        self._image = Image.new("RGB", (right, bottom), PAPER)
        self._pen = ImageDraw.Draw(self._image)
        y = 2.0 * GAP
        for text, size, colour in heading:
            self._write(start, y, text, size, colour, "la")
            y += _line(size)
        self._put_image(left, top)
        self._put_axes(left, top, ups)
        self._put_bar(bar_left, top + (self.height - bar_height) // 2, bar_height, bars, bar_label, right)
        if self.scale_bar != 0:
            self._put_scale_bar(left, top)
        frame = (left, top, left + self.width, top + self.height)
        return Drawn(self._image.size, frame, tuple(self.labels), max(self.bar.axis.first, self.bar.axis.last))

    def _put_image(self, left: int, top: int) -> None:
        """Put the image down: enlarged pixel by pixel, or averaged where there are more than fit."""
        image = Image.fromarray(self.pixels).resize((self.width, self.height), Image.Resampling.BOX)
        self._image.paste(image, (left, top))

    def _put_axes(self, left: int, top: int, ups: list[tuple[float, str]]) -> None:
        bottom, tips = top + self.height, [left - MARK - GAP]
        for place, text in self.across.marks(self.width):
            x = left + place
            self._pen.line((x, bottom, x, bottom + MARK), INK)
            self._write(x, bottom + MARK + GAP // 2, text, TICK, INK, "ma")
        for place, text in ups:
            y = top + place
            self._pen.line((left - MARK, y, left, y), INK)
            tips.append(round(self._write(left - MARK - GAP // 2, y, text, TICK, INK, "rm")[0]))
        below = bottom + MARK + GAP + _line(TICK)
        self._write(left + self.width / 2, below, self.across.name, LABEL, INK, "ma")
        self._write_upward(min(tips) - GAP - _line(LABEL), top + self.height / 2, self.up.name)

    def _put_bar(
        self, left: int, top: int, height: int, marks: list[tuple[float, str]], label: list[str], right: int
    ) -> None:
        ramp = np.repeat(self.bar.colours[:, None], BAR_WIDTH, axis=1)
        self._image.paste(Image.fromarray(ramp).resize((BAR_WIDTH, height), Image.Resampling.BOX), (left, top))
        if self.bar.beyond:
            tip = (left, top - 1, left + BAR_WIDTH - 1, top - 1, left + BAR_WIDTH / 2, top - BAR_WIDTH * 0.6)
            self._pen.polygon(tip, tuple(int(c) for c in self.bar.colours[0]))
        edge = left + BAR_WIDTH
        for place, text in marks:
            y = top + place
            self._pen.line((edge, y, edge + MARK, y), INK)
            self._write(edge + MARK + GAP // 2, y, text, TICK, INK, "lm")
        for number, text in enumerate(reversed(label)):
            self._write_upward(right - 2 * GAP - (number + 1) * _line(LABEL), top + height / 2, text)

    def _put_scale_bar(self, left: int, top: int) -> None:
        """Put a bar of a round length, about a fifth of the width, into the lower left corner, where it has room."""
        extent = self.across.length
        length = self.scale_bar or max((r for r in ROUND_LENGTHS if r <= extent / 4), default=ROUND_LENGTHS[0])
        text = f"{length:g} mm" if length >= 1 else f"{1e3 * length:g} µm"
        pixels, thick = round(length / extent * self.width), max(3, self.height // 120)
        wide, inset = max(pixels, font(LABEL).getlength(text)), max(GAP, self.width // 25)
        if wide + 2 * inset > self.width or _line(LABEL) + thick + 3 * GAP > self.height:
            return
        x, y = left + inset + (wide - pixels) / 2, top + self.height - max(GAP, self.height // 25)
        self._pen.rectangle((x, y - thick, x + pixels, y), PAPER, INK)
        self._write(x + pixels / 2, y - thick - GAP // 2, text, LABEL, PAPER, "md", around=INK)

    def _write(
        self, x: float, y: float, text: str, size: int, colour: str, anchor: str, around: str | None = None
    ) -> Box:
        """Write a label and note its box."""
        edge = {"stroke_width": 1, "stroke_fill": around} if around else {}
        self._pen.text((x, y), text, colour, font(size), anchor=anchor, **edge)  # type: ignore[arg-type]
        box = self._pen.textbbox((x, y), text, font(size), anchor=anchor)
        self.labels.append((text, box))
        return box

    def _write_upward(self, x: float, middle: float, text: str) -> None:
        """Write a label from bottom to top, its left edge at ``x``."""
        width, height = round(font(LABEL).getlength(text)) + 2, _line(LABEL)
        label = Image.new("RGB", (width, height), PAPER)
        ImageDraw.Draw(label).text((1, 0), text, INK, font(LABEL), anchor="la")
        top = min(max(0, round(middle - width / 2)), self._image.height - width)
        self._image.paste(label.transpose(Image.Transpose.ROTATE_90), (round(x), top))
        self.labels.append((text, (round(x), top, round(x) + height, top + width)))


def _line(size: int) -> int:
    """Height of a line of text."""
    return size + 4


def _width(text: str, size: int) -> float:
    return font(size).getlength(text)


def _wrapped(text: str, size: int, room: float) -> list[str]:
    """Break a text into lines that fit."""
    lines: list[str] = []
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and _width(longer, size) <= room:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines
