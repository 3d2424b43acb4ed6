"""Colours, fonts and sizes of all pictures."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from PIL import ImageFont

BACKGROUND, FOREGROUND, SECONDARY = "#ffffff", "#222222", "#6b6b6b"
ACCENT, PLAIN = "#d1495b", "#30638e"
"""What stands out (points of interest, what limits) and what does not."""
TITLE, LABEL, TICK = 15, 14, 12
"""Sizes of letters in pixels."""
FONT = "DejaVu Sans"
GAP = 6
"""Least distance in pixels between two labels, and of a label from what it labels."""
LEAST = 1100
"""Narrower pages are this wide and shrunk, letters and all."""
BAR_START, BAR_SHARE = 0.03, 0.045
"""Where a bar of colours begins beyond its plot, and its width, as shares of the plot's width."""

ColourMap: TypeAlias = Literal["inferno", "magma", "viridis", "cividis", "gray", "hot"]
"""Colours of pressure, dark to bright; all but ``hot`` rise evenly in lightness."""
PRESSURE: ColourMap = "inferno"
SHARE, PLACE, TIME = "cividis", "viridis_r", "turbo"
"""Colours of shares, of distances and areas on the film, and of time."""

NEAR_HUE, FAR_HUE = 45.0, 250.0
LIGHTNESS, CHROMA = 0.78, 0.15
"""Depths differ in hue alone, in the perceptual space Oklab: what is brighter has the higher pressure."""


@cache
def font(size: int) -> ImageFont.FreeTypeFont:
    """Return the font of all pictures in a size, from matplotlib's files (cached)."""
    from matplotlib import get_data_path
    from PIL import ImageFont

    return ImageFont.truetype(Path(get_data_path(), "fonts", "ttf", "DejaVuSans.ttf"), size)


@cache
def colours(name: ColourMap) -> NDArray[np.uint8]:
    """Return the default colour map, (256, 3) from dark to bright (cached)."""
    from matplotlib import colormaps

    return np.array(255 * colormaps[name](np.arange(256))[:, :3] + 0.5, np.uint8)


@cache
def depth_colours() -> NDArray[np.uint8]:
    """Return the colour map of depth: (256, 3) colours of equal lightness, from near (warm) to far (cached)."""
    hue = np.radians(np.linspace(NEAR_HUE, FAR_HUE, 256))
    a, b = CHROMA * np.cos(hue), CHROMA * np.sin(hue)
    # Oklab to linear sRGB (B. Ottosson, 2020), then the sRGB curve
    cones = LIGHTNESS + np.stack(
        [
            0.3963377774 * a + 0.2158037573 * b,
            -0.1055613458 * a - 0.0638541728 * b,
            -0.0894841775 * a - 1.2914855480 * b,
        ]
    )
    linear = (
        np.array(
            [
                [4.0767416621, -3.3077115913, 0.2309699292],
                [-1.2684380046, 2.6097574011, -0.3413193965],
                [-0.0041960863, -0.7034186147, 1.7076147010],
            ]
        )
        @ cones**3
    )
    light = np.clip(linear, 0, 1)
    coded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.array(255 * coded.T + 0.5, np.uint8)


def format_number(value: float) -> str:
    """Format a number as an axis label, with a typographic minus sign."""
    return f"{value:g}".replace("-", "−")
