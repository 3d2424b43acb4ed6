"""Pictures of a volume: maximum-intensity projections with axes in millimetres, a colour bar and a scale bar.

Drawn straight into pixels: every reconstruction draws three, and a plotting library takes longer over them than the
reconstruction needs for the volume.
"""

from __future__ import annotations

from functools import cache
from math import floor, log10
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from steradian.errors import InvalidInput
from steradian.imaging import Volume
from steradian.imaging.conditioning import Display
from steradian.reconstructions.projections import Axis, project

__all__ = ["PLANES", "Axis", "draw_depth_coded", "draw_mip", "draw_projection"]

PLANES: dict[Axis, tuple[Axis, Axis]] = {"x": ("y", "z"), "y": ("x", "z"), "z": ("x", "y")}
"""The two axes that a projection along the third one shows, across and up (depth points down)."""

LINEAR = Display()
LONG_SIDE, SHORT_SIDE = 720, 160
"""Longest side of the projection in pixels, and the least that either side has room for."""
LEFT, TOP, RIGHT, BOTTOM, GAP = 78, 40, 122, 62, 22
BAR_WIDTH, MOST_TICKS, TICK = 18, 8, 5
ROUND_LENGTHS = (0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50)
BRIGHT = 0.1
"""Depths are coloured over those at which columns of at least this share of the brightness have their maximum."""


def draw_mip(volume: Volume, axis: Axis, path: Path, display: Display = LINEAR) -> None:
    """Draw the projection along ``axis`` into a PNG, under a temporary name first.

    Negative values, which a limited view and the record's finite band leave, are shown black.

    Parameters
    ----------
    volume
        The image, with ``display`` applied.
    axis
        The axis to project along; of an image [x, z] from a line of sensors, ``y`` shows the image itself.
    path
        Where to.
    display
        What was applied: whether values are decibels, and down to how many.
    """
    draw_projection(project(volume)[axis], volume, axis, path, display)


def draw_projection(projected: NDArray[Any], volume: Volume, axis: Axis, path: Path, display: Display = LINEAR) -> None:
    """Draw a projection that is there already, in the order of ``volume``'s axes; see :func:`draw_mip`."""
    across, up = PLANES[axis]
    lowest = -display.log_range_db if display.log_range_db else 0.0
    highest = max(float(projected.max()), lowest + 1e-30)
    spans = [_span(volume, name) for name in (across, up)]
    scale = LONG_SIDE / max(last - first for first, last in spans)
    width, height = (max(1, round((last - first) * scale)) for first, last in spans)
    sheet = _Sheet(max(width, SHORT_SIDE), max(height, SHORT_SIDE))
    image = projected.T[::-1] if up == "y" else projected.T  # y points up, depth down from the sensor plane
    sheet.show(_coloured(image, lowest, highest), width, height)
    sheet.title(f"Maximum-intensity projection along {axis}" if volume.dimensions == 3 else "Image below the line")
    sheet.across(spans[0], width, f"{across} (mm)")
    sheet.up(spans[1] if up == "z" else spans[1][::-1], height, f"{up} (mm)" if up == "y" else "z, depth (mm)")
    label = "initial pressure (dB of its maximum)" if lowest else "initial pressure (arb. u.)"
    sheet.colours(lowest, highest, label, _colour_map()[::-1])
    sheet.scale_bar(spans[0][1] - spans[0][0], width, height)
    sheet.save(path)


def draw_depth_coded(volume: Volume, path: Path, display: Display = LINEAR) -> None:
    """Draw the projection along z with the depth of each column's maximum as its colour, its height as brightness.

    Parameters
    ----------
    volume
        The 3-D image, with ``display`` applied.
    path
        Where to; a PNG, under a temporary name first.
    display
        What was applied; decibels are black at their least value.

    Raises
    ------
    InvalidInput
        For an image from a line of sensors, which has no columns to look down.
    """
    if volume.dimensions != 3:
        raise InvalidInput("volume", "an image [x, z]", "a volume [x, y, z]")
    lowest = -display.log_range_db if display.log_range_db else 0.0
    # plane by plane, so that each is looked at twice while it is in the cache
    places = np.stack([plane.argmax(axis=1) for plane in volume.values])
    projected = np.take_along_axis(volume.values, places[..., None], axis=2)[..., 0]
    highest = max(float(projected.max()), lowest + 1e-30)
    brightness = np.clip((projected - lowest) / (highest - lowest), 0, 1)
    depths = 1e3 * volume.axes.z[places]
    first, last = _depth_span(depths[brightness >= BRIGHT], 1e3 * volume.spacing[2])
    hues = _depth_map()[np.clip((depths - first) * (255 / (last - first)), 0, 255).astype(np.uint8)]
    image = (hues * brightness[..., None]).astype(np.uint8)
    spans = [_span(volume, name) for name in ("x", "y")]
    scale = LONG_SIDE / max(end - start for start, end in spans)
    width, height = (max(1, round((end - start) * scale)) for start, end in spans)
    sheet = _Sheet(max(width, SHORT_SIDE), max(height, SHORT_SIDE))
    sheet.show(np.ascontiguousarray(image.transpose(1, 0, 2)[::-1]), width, height)
    sheet.title("Maximum-intensity projection along z, coloured by depth")
    sheet.across(spans[0], width, "x (mm)")
    sheet.up(spans[1][::-1], height, "y (mm)")
    sheet.colours(last, first, "z, depth of the maximum (mm)", _depth_map())
    sheet.scale_bar(spans[0][1] - spans[0][0], width, height)
    sheet.save(path)


def _depth_span(depths: NDArray[np.float64], step: float) -> tuple[float, float]:
    """First and last depth of the colours: all but the outermost hundredth of the columns at either end."""
    first, last = np.percentile(depths, [1, 99]) if depths.size else (0.0, 0.0)
    return float(first), float(max(last, first + step))


class _Sheet:
    """White paper with a projection of ``width`` × ``height`` pixels on it."""

    def __init__(self, width: int, height: int) -> None:
        self._width, self._height = width, height
        self._image = Image.new("RGB", (LEFT + width + RIGHT, TOP + height + BOTTOM), "white")
        self._pen = ImageDraw.Draw(self._image)

    def show(self, pixels: NDArray[np.uint8], width: int, height: int) -> None:
        """Put the projection down: enlarged pixel by pixel, or averaged where there are more than fit."""
        self._image.paste(Image.fromarray(pixels).resize((width, height), Image.Resampling.BOX), (LEFT, TOP))

    def title(self, text: str) -> None:
        self._pen.text((LEFT, TOP - 10), text, "black", _font(15), anchor="ls")

    def across(self, span: tuple[float, float], width: int, label: str) -> None:
        bottom = self._image.height - BOTTOM
        for value in _ticks(*span):
            x = LEFT + (value - span[0]) / (span[1] - span[0]) * width
            self._pen.line((x, bottom, x, bottom + TICK), "black")
            self._pen.text((x, bottom + TICK + 3), f"{value:g}", "black", _font(13), anchor="mt")
        self._pen.text((LEFT + width / 2, self._image.height - 10), label, "black", _font(14), anchor="ms")

    def up(self, span: tuple[float, float], height: int, label: str) -> None:
        for value in _ticks(min(span), max(span)):
            y = TOP + (value - span[0]) / (span[1] - span[0]) * height
            self._pen.line((LEFT - TICK, y, LEFT, y), "black")
            self._pen.text((LEFT - TICK - 3, y), f"{value:g}", "black", _font(13), anchor="rm")
        self._upward(label, 8, TOP + height // 2)

    def colours(self, lowest: float, highest: float, label: str, colours: NDArray[np.uint8]) -> None:
        """Draw the bar of colours (256, 3) from ``highest`` at the top to ``lowest`` at the bottom."""
        left, top, height = LEFT + self._width + GAP, TOP + self._height // 10, self._height * 4 // 5
        ramp = np.repeat(colours[:, None], BAR_WIDTH, axis=1)
        self._image.paste(Image.fromarray(ramp).resize((BAR_WIDTH, height), Image.Resampling.BOX), (left, top))
        right = left + BAR_WIDTH
        for value in _ticks(min(lowest, highest), max(lowest, highest)):
            y = top + (highest - value) / (highest - lowest) * height
            self._pen.line((right, y, right + TICK, y), "black")
            self._pen.text((right + TICK + 3, y), f"{value:g}", "black", _font(12), anchor="lm")
        self._upward(label, self._image.width - 24, top + height // 2)

    def scale_bar(self, extent: float, width: int, height: int) -> None:
        """Put a bar of a round length, about a fifth of the width, into the lower left corner."""
        length = max((r for r in ROUND_LENGTHS if r <= extent / 4), default=ROUND_LENGTHS[0])
        pixels, thick = round(length / extent * width), max(3, height // 90)
        x, y = LEFT + width // 25, TOP + height - height // 20
        self._pen.rectangle((x, y - thick, x + pixels, y), "white")
        label = f"{length:g} mm" if length >= 1 else f"{1e3 * length:g} µm"
        self._pen.text((x + pixels / 2, y - thick - 4), label, "white", _font(13), anchor="ms")

    def save(self, path: Path) -> None:
        draft = path.with_name(path.name + ".new")
        self._image.save(draft, format="png", compress_level=1)
        draft.replace(path)

    def _upward(self, text: str, x: int, middle: int) -> None:
        box = _font(14).getbbox(text)
        label = Image.new("RGB", (round(box[2]), round(box[3]) + 2), "white")
        ImageDraw.Draw(label).text((0, 0), text, "black", _font(14))
        turned = label.transpose(Image.Transpose.ROTATE_90)
        self._image.paste(turned, (x, max(0, middle - turned.height // 2)))


def _span(volume: Volume, name: str) -> tuple[float, float]:
    """From the first voxel's outer edge to the last one's, in mm."""
    places = 1e3 * volume.coordinates(name)
    half = 0.5e3 * volume.spacing[volume.names.index(name)]
    return float(places[0] - half), float(places[-1] + half)


def _coloured(image: NDArray[Any], lowest: float, highest: float) -> NDArray[np.uint8]:
    share = (image - lowest) * (255 / (highest - lowest))
    coloured: NDArray[np.uint8] = _colour_map()[np.clip(share, 0, 255).astype(np.uint8)]
    return coloured


def _ticks(first: float, last: float) -> list[float]:
    """Round numbers from first to last."""
    raw = (last - first) / MOST_TICKS
    power = 10.0 ** floor(log10(raw))
    step = next(step for step in (power, 2 * power, 5 * power, 10 * power) if step >= raw * (1 - 1e-9))
    numbers = range(round(np.ceil(first / step - 1e-6)), round(np.floor(last / step + 1e-6)) + 1)
    return [float(f"{number * step:.12g}") for number in numbers]


@cache
def _colour_map() -> NDArray[np.uint8]:
    """(256, 3) colours from dark to bright."""
    from matplotlib import colormaps

    return np.array(255 * colormaps["inferno"](np.arange(256))[:, :3] + 0.5, np.uint8)


@cache
def _depth_map() -> NDArray[np.uint8]:
    """(256, 3) bright colours, near to far: warm ones come forward."""
    from matplotlib import colormaps

    return np.array(255 * colormaps["turbo"](np.linspace(0.95, 0.08, 256))[:, :3] + 0.5, np.uint8)


@cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    from matplotlib import get_data_path

    return ImageFont.truetype(Path(get_data_path(), "fonts", "ttf", "DejaVuSans.ttf"), size)
