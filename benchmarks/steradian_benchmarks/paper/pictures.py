"""Shared plotting functions of the sections: panels in millimetres, small PNG files."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image, ImageChops

_DPI = 90
_OFF = 12
_OFF_ANYWHERE = 32
"""Of 255, by which a channel may be off where a picture has few colours: all but a thousandth of it, and all of it."""
FORMATS = {"xy": ("x (mm)", "y (mm)"), "xz": ("x (mm)", "z, depth (mm)"), "yz": ("y (mm)", "z, depth (mm)")}


def figure(width: float, height: float, rows: int = 1, columns: int = 1, **options: Any) -> tuple[Figure, list[Axes]]:
    """Create a matplotlib figure of given size in inches; return it and its panels, row by row."""
    made = Figure(figsize=(width, height), dpi=_DPI, layout="constrained")
    panels = made.subplots(rows, columns, squeeze=False, **options)
    return made, list(panels.ravel())


def show(
    axes: Axes,
    image: NDArray[Any],
    across: NDArray[np.float64],
    up: NDArray[np.float64],
    title: str,
    plane: str = "xy",
    highest: float | None = None,
) -> None:
    """Draw an image [across, up] in grey, negative values black; coordinates in metres."""
    dx, dy = 1e3 * (across[1] - across[0]), 1e3 * (up[1] - up[0])
    left, right = 1e3 * across[0] - dx / 2, 1e3 * across[-1] + dx / 2
    low, high = 1e3 * up[0] - dy / 2, 1e3 * up[-1] + dy / 2
    downward = plane != "xy"
    extent = (left, right, high, low) if downward else (left, right, low, high)
    axes.imshow(
        np.clip(image, 0, None).T,
        cmap="gray",
        vmin=0,
        vmax=highest or float(image.max()),
        extent=extent,
        origin="upper" if downward else "lower",
    )
    axes.set_title(title, fontsize=9)
    axes.set_xlabel(FORMATS[plane][0], fontsize=8)
    axes.set_ylabel(FORMATS[plane][1], fontsize=8)
    axes.tick_params(labelsize=7)


def curves(
    axes: Axes,
    x: Sequence[float],
    series: dict[str, Sequence[float | None]],
    labels: tuple[str, str],
    *,
    bold: str | None = None,
) -> None:
    """Draw named curves with a legend; the emphasised one in front."""
    for name, values in series.items():
        y = [np.nan if value is None else value for value in values]
        axes.plot(x, y, ".-", markersize=3, linewidth=2.2 if name == bold else 1.0, label=name)
    axes.set_xlabel(labels[0], fontsize=8)
    axes.set_ylabel(labels[1], fontsize=8)
    axes.tick_params(labelsize=7)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7)


def few_colours(picture: Image.Image) -> Image.Image:
    """Reduce an RGB picture to a palette of 256 colours, unless the difference would be visible."""
    fewer = picture.quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE)
    off = np.asarray(ImageChops.difference(picture, fewer.convert("RGB"))).max(-1)
    seen = off.max() > _OFF_ANYWHERE or np.count_nonzero(off > _OFF) > off.size / 1000
    return picture if seen else fewer


def save(made: Figure, path: Path) -> None:
    """Write a figure into a small palette PNG by an atomic write."""
    drawn = io.BytesIO()
    made.savefig(drawn, format="png")
    picture = few_colours(Image.open(drawn).convert("RGB"))
    draft = path.with_name(path.name + ".new")
    picture.save(draft, format="png", optimize=True)
    draft.replace(path)
