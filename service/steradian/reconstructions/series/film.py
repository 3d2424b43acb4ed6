"""Film of a series: its projections one after another with one colour scale, as an animated GIF."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from steradian.core.atomic_files import atomic_write
from steradian.core.exceptions import InvalidInput
from steradian.core.quantity_ranges import as_finite_float
from steradian.drawing.style import font
from steradian.reconstructions.volumes.panels import ColourScale, Panel, colour_table

STRIP = 22
"""Height in pixels of the strip with the name below the image."""
WHITE, BLACK, GREY = 255, 254, 253
"""Places of the palette; those before have the colour map."""
LETTERS = 12
MOST_FRAMES = 2000
"""Most volumes of a film."""
ROUND = (0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50)
"""Round lengths of a scale bar in mm."""


def write_film(
    panels: Sequence[Panel], scale: ColourScale, path: Path, *, interval: float = 0.2, size: int = 480
) -> Path:
    """Write panels as an animated GIF that repeats (atomic write).

    Parameters
    ----------
    panels
        One for each volume, of the same size.
    scale
        Colour scale of all; colours are values.
    path
        File to write, ``.gif``.
    interval
        Time that each is shown in s, 0.02 to 10; viewers round it to 0.01 s.
    size
        Longest side of the image in pixels, 60 to 2000.

    Raises
    ------
    InvalidInput
        When the ending is another one, or a value is out of range.
    """
    if path.suffix.lower() != ".gif":
        raise InvalidInput("file", path.name, ".gif")
    if not 0.02 <= as_finite_float("interval", interval, "0.02 to 10 s") <= 10:
        raise InvalidInput("interval", interval, "0.02 to 10 s")
    if size != int(size) or not 60 <= size <= 2000:
        raise InvalidInput("size", size, "a whole number from 60 to 2000 (pixels)")
    if scale.depth_span is not None:
        raise InvalidInput("depth_coded", "true", "false for a film")
    frames = _frames(panels, scale, int(size))
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as beside:
        first = next(frames)
        first.save(
            beside,
            format="GIF",
            save_all=True,
            append_images=frames,
            duration=round(1000 * interval),
            loop=0,
            optimize=False,
            disposal=1,
        )
    return path


def _frames(panels: Sequence[Panel], scale: ColourScale, size: int) -> Iterator[Image.Image]:
    """Yield the pictures with a common palette."""
    colours = np.full((256, 3), 255, np.uint8)
    places = np.minimum(256 * np.linspace(0, 1, GREY), 255).astype(int)
    colours[:GREY] = np.round(255 * colour_table(scale.colour_map)[places])
    colours[GREY], colours[BLACK] = 200, 0
    for panel in panels:
        width, height = (abs(last - first) for first, last in (panel.across, panel.up))
        pixels = size / max(width, height)
        room = max(1, round(width * pixels)), max(1, round(height * pixels))
        share = scale.share(panel.image)
        image = np.where(np.isnan(share), GREY, np.round(np.nan_to_num(share) * (GREY - 1))).astype(np.uint8)
        drawn = Image.fromarray(image[::-1]).resize(room, Image.Resampling.NEAREST)
        sheet = Image.new("P", (room[0], room[1] + STRIP), WHITE)
        sheet.putpalette(colours.tobytes())
        sheet.paste(drawn, (0, 0))
        pen = ImageDraw.Draw(sheet)
        pen.fontmode = "1"
        length = max((each for each in ROUND if each <= width / 4 + 1e-9), default=ROUND[0])
        text = f"{length:g} mm" if length >= 1 else f"{1e3 * length:g} µm"
        bar, middle = round(length * pixels), room[1] + STRIP // 2
        pen.rectangle((4, middle - 2, 4 + bar, middle + 1), BLACK)
        pen.text((8 + bar, middle), text, BLACK, font(LETTERS), anchor="lm")
        pen.text((room[0] - 4, middle), panel.name, BLACK, font(LETTERS), anchor="rm")
        yield sheet
