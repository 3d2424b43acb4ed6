"""Scale bar of an image in a figure."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from steradian.drawing.style import FONT

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BAR_LENGTHS = (0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50)
"""Round lengths of a scale bar in mm."""


def draw_scale_bar(
    axes: Axes, across: tuple[float, float], up: tuple[float, float], length: float | None, font_size: float
) -> None:
    """Draw a scale bar with its length at the lower left of an image.

    Parameters
    ----------
    axes
        Where to.
    across, up
        First and last edge of the image in mm, from left to right and from bottom to top.
    length
        Length in mm; None: a round one.
    font_size
        Size of letters in points.
    """
    from matplotlib.patches import Rectangle
    from matplotlib.patheffects import withStroke

    width, rise = across[1] - across[0], up[1] - up[0]
    length = length or max((each for each in BAR_LENGTHS if each <= width / 3 + 1e-9), default=BAR_LENGTHS[0])
    x, y = across[0] + 0.06 * width, up[0] + 0.05 * rise
    thick = 0.015 * abs(width) * np.sign(rise)
    axes.add_patch(Rectangle((x, y), length, thick, facecolor="white", edgecolor="black", linewidth=0.3))
    text = f"{length:g} mm" if length >= 1 else f"{1e3 * length:g} µm"
    outline: Any = [withStroke(linewidth=1, foreground="black")]
    axes.text(x, y + 2 * thick, text, color="white", fontsize=font_size, ha="left", va="bottom",
              path_effects=outline, fontfamily=FONT)  # fmt: skip
