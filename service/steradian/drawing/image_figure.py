"""Figure of one image with axes, colour bar and scale bar.

Every reconstruction draws several, and a plotting library takes longer over them than the reconstruction needs for
the volume. Margins follow from the labels, which therefore never leave the sheet nor meet each other.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from steradian.core.atomic_files import atomic_write
from steradian.drawing.canvas import MARK, Box, Canvas, ColourBar, left_margin, line_height, right_margin, wrapped
from steradian.drawing.style import BACKGROUND, FOREGROUND, GAP, LABEL, SECONDARY, TICK, TITLE, font
from steradian.drawing.ticks import Axis

SHORT_SIDE = 160
"""Room in pixels that either side of the image has at least, however thin the image is."""
BAR_WIDTH = 18
ROUND_LENGTHS = (0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50)


@dataclass(frozen=True)
class Layout:
    """Rendered plot areas with their positions on the page.

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
class ImageFigure:
    """Figure of an image (height, width, 3) enlarged to ``width`` × ``height`` pixels, with axes and labels.

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
    bar: ColourBar
    scale_bar: float | None = None

    def save(self, path: Path) -> Layout:
        """Draw the figure and write a PNG file by an atomic write."""
        drawn = self.draw()
        with atomic_write(path) as file:
            # Pixels are enlarged to blocks: runs are most of what there is to find, in four fifths of the time.
            self._pen.image.save(file, format="png", compress_level=1, compress_type=zlib.Z_RLE)
        return drawn

    def draw(self) -> Layout:
        """Lay out and draw the figure; return its pixels."""
        room_x, room_y = max(self.width, SHORT_SIDE), max(self.height, SHORT_SIDE)
        # what is narrower than its room stands in its middle, and the left margin shrinks by what is free there
        left = left_margin(self.up, self.height) + (room_x - self.width) // 2
        bar_left = left + self.width + 4 * GAP
        bar_height = max(round(0.8 * self.height), SHORT_SIDE)
        bar_label = wrapped(self.bar.axis.name, LABEL, max(room_y, bar_height))
        right = bar_left + BAR_WIDTH + right_margin(self.bar.axis, bar_height, len(bar_label))
        heading = [(text, TITLE, FOREGROUND) for text in wrapped(self.title, TITLE, right - 4 * GAP)]
        heading += [(text, TICK, SECONDARY) for text in wrapped(self.remark, TICK, right - 4 * GAP)]
        widest = max(font(size).getlength(text) for text, size, _ in heading)
        start = min(left, max(2 * GAP, right - 2 * GAP - round(widest)))
        top = 2 * GAP + sum(line_height(size) for _, size, _ in heading) + 2 * GAP + (room_y - self.height) // 2
        foot = MARK + GAP + line_height(TICK) + line_height(LABEL) + 2 * GAP
        bottom = max(top + self.height + foot, top + (self.height + bar_height) // 2 + 2 * GAP)
        self._pen = Canvas(right, bottom)
        y = 2.0 * GAP
        for text, size, colour in heading:
            self._pen.write(start, y, text, size, colour, "la")
            y += line_height(size)
        self._put_image(left, top)
        self._pen.put_axes(left, top, self.width, self.height, self.across, self.up)
        bar_top = top + (self.height - bar_height) // 2
        self._pen.draw_colour_bar(self.bar, bar_left, bar_top, BAR_WIDTH, bar_height, right, bar_label)
        if self.scale_bar != 0:
            self._put_scale_bar(left, top)
        frame = (left, top, left + self.width, top + self.height)
        highest = max(self.bar.axis.first, self.bar.axis.last)
        return Layout(self._pen.image.size, frame, tuple(self._pen.labels), highest)

    def _put_image(self, left: int, top: int) -> None:
        """Draw the image: enlarged pixel by pixel, or reduced by averaging if larger than the plot area."""
        image = Image.fromarray(self.pixels).resize((self.width, self.height), Image.Resampling.BOX)
        self._pen.image.paste(image, (left, top))

    def _put_scale_bar(self, left: int, top: int) -> None:
        """Draw a scale bar of a round length, about a fifth of the width, at the lower left, if there is room."""
        extent = self.across.length
        length = self.scale_bar or max((r for r in ROUND_LENGTHS if r <= extent / 4), default=ROUND_LENGTHS[0])
        text = f"{length:g} mm" if length >= 1 else f"{1e3 * length:g} µm"
        pixels, thick = round(length / extent * self.width), max(3, self.height // 120)
        wide, inset = max(pixels, font(LABEL).getlength(text)), max(GAP, self.width // 25)
        if wide + 2 * inset > self.width or line_height(LABEL) + thick + 3 * GAP > self.height:
            return
        x, y = left + inset + (wide - pixels) / 2, top + self.height - max(GAP, self.height // 25)
        self._pen.strokes.rectangle((x, y - thick, x + pixels, y), BACKGROUND, FOREGROUND)
        self._pen.write(x + pixels / 2, y - thick - GAP // 2, text, LABEL, BACKGROUND, "md", around=FOREGROUND)
